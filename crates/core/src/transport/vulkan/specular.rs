//! Cotangents of the specular radiance of glossy triangles, μ₀ and μ, of each rank those of its own. Where the device holds states whole a
//! pass accumulates μ in the buffers of outgoing light. Where states live on the host so do both, and what is worked on is in the window
//! of outgoing light.

use super::distributed::Distributed;
use super::residency::{Part, View};
use super::state::{page, pages};
use super::{Context, real};
use crate::plan::{Plan, Residency};
use crate::transport::TransportError;
use antirad_gpu::{Buffer, Device, GpuError};
use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Which of the two cotangents of specular radiance.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Specular {
    /// μ₀, of the loss.
    Given,
    /// μ = μ₀ + Uᵀ λ.
    Current,
}

/// Both cotangents of specular radiance, by glossy group.
pub enum SpecularCotangents {
    Device {
        given: Vec<Option<Buffer>>,
        /// `None` where it is in the buffers of outgoing light.
        current: Option<Vec<Option<Buffer>>>,
    },
    Host {
        given: Vec<Option<HostPage>>,
        current: Vec<Option<HostPage>>,
    },
}

/// The values of one rank's triangles of a group.
pub struct HostPage(Mutex<Vec<u8>>);

impl HostPage {
    fn values(&self) -> MutexGuard<'_, Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SpecularCotangents {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        if plan.residency == Residency::Device {
            let pages = || pages(device, "cotangent: specular", plan.own_pages(|group| group.class.glossy));
            let current = (!plan.states_are_whole()).then(pages).transpose()?;
            return Ok(Self::Device { given: pages()?, current });
        }
        let page = |g: usize| {
            let bytes = plan.page_bytes(&plan.own(g)) as usize;
            plan.layout.groups[g].class.glossy.then(|| HostPage(Mutex::new(vec![0; bytes])))
        };
        let all = || (0..plan.layout.groups.len()).map(page).collect();
        Ok(Self::Host { given: all(), current: all() })
    }

    /// Sets μ₀ of the triangles of a group; without values, to zero.
    ///
    /// # Errors
    /// Fails if the group is not glossy, or if the device fails.
    pub fn set(&self, context: &Context, g: usize, values: Option<&[f64]>) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        let (group, part) = (&plan.layout.groups[g], plan.own(g));
        if part.tiles.is_empty() {
            return Ok(());
        }
        let of_slot = plan.bins.count() * plan.channels as usize;
        let [first, own] = [group, &part].map(|group| plan.layout.slots_of(&group.tiles));
        let own = [own.start, own.end].map(|slot| (slot - first.start) as usize * of_slot);
        let values = values.map(|values| &values[own[0]..own[1]]);
        match (self, values) {
            (Self::Device { given, .. }, Some(values)) => {
                Ok(real::upload(device, page(given, g)?, precision, values)?)
            }
            (Self::Device { given, .. }, None) => {
                Ok(View::resident(page(given, g)?, 0, plan.page_bytes(&part)).clear(device)?)
            }
            (Self::Host { given, .. }, Some(values)) => {
                *host_page(given, g)?.values() = real::encode(precision, values);
                Ok(())
            }
            (Self::Host { given, .. }, None) => {
                host_page(given, g)?.values().fill(0);
                Ok(())
            }
        }
    }

    /// The buffer in which a pass accumulates μ of a group.
    fn accumulated<'a>(&'a self, context: &'a Context, g: usize) -> Result<&'a Buffer, TransportError> {
        match self {
            Self::Device { current: Some(current), .. } => page(current, g),
            _ => context.outgoing.specular_of(g),
        }
    }

    /// Opens the view in which a pass accumulates μ of what this rank holds of a group, beside the view
    /// `back` of the same bins of a state. The values are initially μ₀ if `given`, otherwise zero.
    ///
    /// # Errors
    /// Fails if the group is not glossy, or if the device fails.
    pub fn open<'a>(
        &'a self,
        context: &'a Context,
        g: usize,
        back: &View,
        given: bool,
    ) -> Result<View<'a>, TransportError> {
        let device = &context.device;
        let view = back.beside(self.accumulated(context, g)?);
        match self {
            _ if !given => view.clear(device)?,
            Self::Device { given, .. } => {
                let mut batch = device.batch()?;
                view.copy_from(&mut batch, page(given, g)?)?;
                batch.defer()?;
            }
            Self::Host { given, .. } => view.upload(device, &host_page(given, g)?.values())?,
        }
        Ok(view)
    }

    /// Keeps the values that a view holds, where the device does not.
    ///
    /// # Errors
    /// Fails if the group is not glossy, or if the device fails.
    pub fn keep(
        &self,
        context: &Context,
        which: Specular,
        g: usize,
        view: &View,
    ) -> Result<(), TransportError> {
        let Some(page) = self.on_host(which, g)? else { return Ok(()) };
        *page.values() = view.download(&context.device)?;
        Ok(())
    }

    /// What this rank holds of a group, on the device.
    ///
    /// # Errors
    /// Fails if the group is not glossy, or if the device fails.
    pub fn show<'a>(
        &'a self,
        context: &'a Context,
        which: Specular,
        g: usize,
    ) -> Result<View<'a>, TransportError> {
        let Context { device, plan, scene, .. } = context;
        let own = plan.own(g);
        let (first, bytes) = (plan.layout.slots_of(&own.tiles).start, plan.page_bytes(&own));
        match (self, which) {
            _ if bytes == 0 => Ok(View::resident(&scene.no_bins, first, 0)),
            (Self::Device { given, .. }, Specular::Given) => {
                Ok(View::resident(page(given, g)?, first, bytes))
            }
            (Self::Device { .. }, Specular::Current) => {
                Ok(View::resident(self.accumulated(context, g)?, first, bytes))
            }
            (Self::Host { .. }, _) => {
                let view = View::resident(self.accumulated(context, g)?, first, bytes);
                if let Some(page) = self.on_host(which, g)? {
                    view.upload(device, &page.values())?;
                }
                Ok(view)
            }
        }
    }

    /// The values of a group, whichever ranks hold them; `None` where it is not glossy. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended.
    pub fn download(
        &self,
        context: &Context,
        which: Specular,
        g: usize,
    ) -> Result<Option<Vec<f64>>, TransportError> {
        let Context { device, plan, .. } = context;
        if !plan.layout.groups[g].class.glossy {
            return Ok(None);
        }
        let slots = plan.layout.slots_of(&plan.own(g).tiles);
        let held = match self.on_host(which, g)? {
            Some(page) => page.values().clone(),
            None if slots.is_empty() => Vec::new(),
            None => self.show(context, which, g)?.download(device)?,
        };
        let own = |some: &Range<u32>, values: &mut [u8]| {
            let first = u64::from(some.start - slots.start) * plan.bin_bytes();
            values.copy_from_slice(&held[first as usize..][..values.len()]);
            Ok(())
        };
        let all = Distributed::new(device, plan)
            .gathered(&plan.layout.slots_of(&plan.layout.groups[g].tiles), own)?;
        Ok(Some(real::decode(plan.settings.precision, &all)))
    }

    fn on_host(&self, which: Specular, g: usize) -> Result<Option<&HostPage>, TransportError> {
        let Self::Host { given, current } = self else { return Ok(None) };
        host_page(if which == Specular::Given { given } else { current }, g).map(Some)
    }
}

fn host_page(pages: &[Option<HostPage>], g: usize) -> Result<&HostPage, TransportError> {
    let page = pages.get(g).and_then(Option::as_ref);
    page.ok_or_else(|| TransportError::missing(format!("specular cotangents of group {g}")))
}

/// The bins of a state that a pass of the adjoint accumulates, and μ of the same triangles.
pub struct Accumulated<'a> {
    pub group: usize,
    /// Cotangents of H(b) behind the antiradiance. `None` where the class has no bins.
    pub back: Option<View<'a>>,
    /// Cotangents of specular radiance. `None` where the class is not glossy.
    pub front: Option<View<'a>>,
}

impl<'a> Accumulated<'a> {
    /// Opens the views of a group: of the bins of `y`, initially zero, and of the cotangent of specular
    /// radiance, initially μ₀ of the loss if `given`, otherwise zero.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn open(
        context: &'a Context,
        specular: &'a SpecularCotangents,
        group: usize,
        y: &'a super::State,
        given: bool,
    ) -> Result<Self, TransportError> {
        let Context { device, plan, .. } = context;
        let back = Part::held(plan, group).map(|part| y.receive(device, &part)).transpose()?;
        let glossy = plan.layout.groups[group].class.glossy;
        let front = back.as_ref().filter(|_| glossy);
        let front = front.map(|back| specular.open(context, group, back, given)).transpose()?;
        Ok(Self { group, back, front })
    }
}
