//! The scene and its outgoing light as arrays, in the order and the coordinates of the plan.

use super::lobes::Lobes;
use super::real::Real;
use super::taps::Layout;
use crate::backend::{Array, Cpu};
use crate::plan::{Group, Plan};
use crate::transport::scene_values;
use antirad_base::parallel;
use antirad_base::usage::OverBudget;
use antirad_scene::Scene;

/// Numbers of an RGB value of a slot, and of a bin in the table.
pub const SLOT: usize = 4;

/// What operators only read.
pub struct SceneArrays<T> {
    /// Centroid, area, normal and characteristic area of each slot.
    pub facets: Array<T>,
    /// Corners of each slot.
    pub corners: Array<T>,
    /// Material of each slot.
    pub surfaces: Array<T>,
    /// Centre of each bin, and c_b.
    pub bin_table: Array<T>,
    /// Per group, the radiance of lamps that glossy triangles reflect, in units of light, by triangle, bin,
    /// channel.
    pub first_bounce: Vec<Option<Array<T>>>,
    pub lobes: Lobes<T>,
}

impl<T: Real> SceneArrays<T> {
    /// Light is counted in units of `unit`, W/(m² sr); `emitted` is what each triangle of the scene emits.
    pub fn new(
        cpu: &Cpu,
        scene: &Scene,
        plan: &Plan,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<Self, OverBudget> {
        let filled = |label: &str, values: &[f64]| cpu.filled(label, reals(values));
        let first_bounce = |group: &Group| {
            let lit = plan.has_first_bounce() && group.class.glossy;
            lit.then(|| cpu.array("first bounce", page_reals(plan, group))).transpose()
        };
        Ok(Self {
            facets: filled("facets", &scene_values::facets(plan))?,
            corners: filled("corners", &scene_values::corners(plan))?,
            surfaces: filled("surfaces", &scene_values::surfaces(scene, plan, emitted, unit))?,
            bin_table: filled("bin table", &scene_values::bin_table(plan))?,
            first_bounce: plan.layout.groups.iter().map(first_bounce).collect::<Result<_, _>>()?,
            lobes: Lobes::new(cpu, scene, plan)?,
        })
    }

    /// Replaces the materials and what is emitted; geometry and classes stay as planned.
    pub fn set_materials(&mut self, scene: &Scene, plan: &Plan, emitted: &[[f64; 3]], unit: f64) {
        let surfaces = scene_values::surfaces(scene, plan, emitted, unit);
        self.surfaces.copy_from_slice(&reals(&surfaces));
        self.lobes.set(scene, plan);
    }

    /// Sets the radiance of lamps that glossy triangles reflect, by group.
    pub fn set_first_bounce(&mut self, values: &[Option<Vec<f64>>]) {
        for (page, values) in self.first_bounce.iter_mut().zip(values) {
            if let (Some(page), Some(values)) = (page, values) {
                page.copy_from_slice(&reals(values));
            }
        }
    }
}

/// Outgoing light of the fronts, E + K H, W/(m² sr).
pub struct Outgoing<T> {
    /// Diffuse radiance of each slot, four numbers.
    pub radiance: Array<T>,
    pub specular: Specular<T>,
}

/// Specular radiance of the fronts of glossy triangles.
pub enum Specular<T> {
    /// A page for each glossy group.
    Pages(Vec<Option<Array<T>>>),
    /// One page for a group at a time, where several ranks hold the light.
    Window(Option<Array<T>>),
}

impl<T: Real> Outgoing<T> {
    pub fn new(cpu: &Cpu, plan: &Plan) -> Result<Self, OverBudget> {
        let page =
            |bytes: u64| (bytes > 0).then(|| cpu.array("specular radiance", count::<T>(bytes))).transpose();
        let specular = match plan.states_are_whole() {
            true => {
                let pages = plan.own_pages(|group| group.class.glossy).map(page);
                Specular::Pages(pages.collect::<Result<_, _>>()?)
            }
            false => Specular::Window(page(u64::from(plan.specular_window()) * plan.tile_bytes())?),
        };
        Ok(Self { radiance: cpu.array("radiance", count::<T>(plan.radiance_bytes()))?, specular })
    }
}

impl<T: Real> Specular<T> {
    /// Specular radiance of a group, by triangle, bin, channel; empty where it is not glossy.
    pub fn of(&self, plan: &Plan, group: usize) -> &[T] {
        let page = match self {
            Self::Pages(pages) => pages[group].as_ref(),
            Self::Window(window) => window.as_ref(),
        };
        let of = &plan.layout.groups[group];
        page.filter(|_| of.class.glossy).map_or(&[], |page| &page[..page_reals(plan, of)])
    }

    /// Specular radiance of a group, to be changed, by triangle, bin, channel; empty where it is not glossy.
    pub fn of_mut(&mut self, plan: &Plan, group: usize) -> &mut [T] {
        let page = match self {
            Self::Pages(pages) => pages[group].as_mut(),
            Self::Window(window) => window.as_mut(),
        };
        let of = &plan.layout.groups[group];
        page.filter(|_| of.class.glossy).map_or(&mut [], |page| &mut page[..page_reals(plan, of)])
    }
}

/// What all operators share: the plan and the scene.
pub struct Context<T> {
    pub cpu: Cpu,
    pub plan: Plan,
    pub layout: Layout<T>,
    pub scene: SceneArrays<T>,
}

impl<T: Real> Context<T> {
    /// Half of `near_field`.
    pub fn half_range(&self) -> T {
        T::of(0.5 * self.plan.settings.near_field)
    }

    /// Numbers of the bins of a triangle.
    pub fn bins(&self) -> usize {
        self.layout.count * self.layout.channels
    }
}

/// Numbers of the bins of a group.
pub fn page_reals(plan: &Plan, group: &Group) -> usize {
    plan.layout.slots_of(&group.tiles).len() * plan.bins.count() * plan.channels as usize
}

/// Numbers in so many bytes.
pub fn count<T>(bytes: u64) -> usize {
    bytes as usize / size_of::<T>()
}

/// Numbers of the type of the plan.
pub fn reals<T: Real>(values: &[f64]) -> Vec<T> {
    values.iter().map(|&value| T::of(value)).collect()
}

/// Numbers of the type of the plan as f64.
pub fn values<T: Real>(reals: &[T]) -> Vec<f64> {
    reals.iter().map(|&real| real.into()).collect()
}

/// Rows of four.
pub fn rows<T: Real>(reals: &[T]) -> Vec<[f64; 4]> {
    let row = |row: &[T]| [row[0].into(), row[1].into(), row[2].into(), row[3].into()];
    reals.chunks_exact(SLOT).map(row).collect()
}

/// Calls `with` with the number and the values of each slot, on all threads.
pub fn each_slot<T: Real>(values: &mut [T], with: impl Fn(usize, &mut [T]) + Sync) {
    const EACH: usize = 1 << 10;
    parallel::each(values.chunks_mut(SLOT * EACH).enumerate(), |(chunk, values)| {
        (chunk * EACH..).zip(values.chunks_exact_mut(SLOT)).for_each(|(slot, value)| with(slot, value));
    });
}
