//! Incident light as plain vectors.

use super::real::Real;
use crate::backend::{Cpu, Lease};
use crate::plan::Plan;
use antirad_base::usage::OverBudget;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Incident light: irradiance of every slot, and radiance per bin of the triangles that this rank computes. Its memory belongs to a
/// pool, and is used again when it is dropped.
pub struct Vector<T> {
    /// E, W/m², four numbers per slot; the last is unused and zero.
    pub irradiance: Vec<T>,
    /// A(b) = H(b) / c_b, W/(m² sr), per group, by triangle, bin, channel; empty where the class has no bins.
    /// For a blocker this is also the antiradiance of the back: J is the identity on this state.
    pub bins: Vec<Vec<T>>,
    leases: Vec<Lease>,
    pool: Weak<Pool<T>>,
}

/// The memory of a vector.
struct Memory<T> {
    irradiance: Vec<T>,
    bins: Vec<Vec<T>>,
    leases: Vec<Lease>,
}

/// Memory of vectors that are not in use.
pub struct Pool<T>(Mutex<Vec<Memory<T>>>);

impl<T> Pool<T> {
    fn idle(&self) -> MutexGuard<'_, Vec<Memory<T>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Real> Pool<T> {
    /// Allocates as many vectors as the plan counts.
    ///
    /// # Errors
    /// Fails if the memory budget of the CPU does not hold them.
    pub fn new(cpu: &Cpu, plan: &Plan) -> Result<Arc<Self>, OverBudget> {
        let vectors = (0..plan.vectors()).map(|_| Memory::new(cpu, plan)).collect::<Result<_, _>>()?;
        Ok(Arc::new(Self(Mutex::new(vectors))))
    }

    /// A vector of undefined values: one that is not in use, or a new one, which exceeds the plan.
    ///
    /// # Errors
    /// Fails if the memory budget of the CPU does not hold a new one.
    pub fn take(self: &Arc<Self>, cpu: &Cpu, plan: &Plan) -> Result<Vector<T>, OverBudget> {
        let idle = self.idle().pop();
        let Memory { irradiance, bins, leases } = idle.map_or_else(|| Memory::new(cpu, plan), Ok)?;
        Ok(Vector { irradiance, bins, leases, pool: Arc::downgrade(self) })
    }
}

impl<T: Real> Memory<T> {
    fn new(cpu: &Cpu, plan: &Plan) -> Result<Self, OverBudget> {
        let mut leases = vec![cpu.lease("state: irradiance", plan.irradiance_bytes())?];
        let mut page = |bytes: u64| {
            if bytes > 0 {
                leases.push(cpu.lease("state: bins", bytes)?);
            }
            Ok(vec![T::ZERO; bytes as usize / size_of::<T>()])
        };
        let bins = plan.own_pages(|group| group.class.has_bins()).map(&mut page).collect::<Result<_, _>>()?;
        Ok(Self {
            irradiance: vec![T::ZERO; plan.irradiance_bytes() as usize / size_of::<T>()],
            bins,
            leases,
        })
    }
}

impl<T> Drop for Vector<T> {
    fn drop(&mut self) {
        if let Some(pool) = self.pool.upgrade() {
            let (irradiance, bins) = (std::mem::take(&mut self.irradiance), std::mem::take(&mut self.bins));
            pool.idle().push(Memory { irradiance, bins, leases: std::mem::take(&mut self.leases) });
        }
    }
}

impl<T: Real> Vector<T> {
    /// Irradiance, then the bins of each group.
    pub fn parts(&self) -> impl Iterator<Item = &[T]> {
        std::iter::once(&self.irradiance).chain(&self.bins).map(Vec::as_slice)
    }

    /// The irradiance, then the bins of each group, to be changed.
    pub fn parts_mut(&mut self) -> impl Iterator<Item = &mut [T]> {
        std::iter::once(&mut self.irradiance).chain(&mut self.bins).map(Vec::as_mut_slice)
    }
}
