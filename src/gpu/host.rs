//! Memory that host and device share, as with CPU drivers.

use std::slice;

use ash::vk;
use bytemuck::Pod;

use super::Result;
use super::buffer::BufferSlice;
use super::device::Device;
use super::transfer::UsedScopes;

impl Device {
    /// Calls `with` with the values of parts of buffers, while nothing runs on the device that uses buffers of the same scopes.
    /// `None` unless the device is a CPU, whose memory is the host's, and not of [`Device::kernels_only`]. `with` must not use
    /// the device.
    pub fn read_on_host<T: Pod, R, const N: usize>(
        &self,
        parts: [BufferSlice; N],
        with: impl FnOnce([&[T]; N]) -> R,
    ) -> Result<Option<R>> {
        self.edit_on_host([], parts, |[], parts| with(parts))
    }

    /// Calls `with` with the values of parts of buffers, to change them, and of others, while nothing runs on the device that uses
    /// buffers of the same scopes. `None` where the device is no CPU, or a part to change overlaps another. `with` must not use
    /// the device.
    pub fn edit_on_host<T: Pod, R, const M: usize, const N: usize>(
        &self,
        parts: [BufferSlice; M],
        others: [BufferSlice; N],
        with: impl FnOnce([&mut [T]; M], [&[T]; N]) -> R,
    ) -> Result<Option<R>> {
        let (Some(own), Some(places)) = (self.places(parts)?, self.places(others)?) else { return Ok(None) };
        for (at, part) in parts.iter().enumerate() {
            if parts[..at].iter().chain(&others).any(|other| other.overlaps(part)) {
                return Ok(None);
            }
        }
        let mut used = UsedScopes::default();
        parts.iter().chain(&others).for_each(|part| used.add(part.buffer.use_of_buffers()));
        self.execute_deferred(&used)?;
        let _alone = used.by_host();
        // SAFETY: the memory is mapped while the borrowed buffers live, and the locks keep away everything else that reads or
        // writes there: batches that run, and other calls of this. The parts overlap neither each other nor `others`. Any bytes
        // are a `T`.
        let own = own.map(|(place, count)| unsafe { slice::from_raw_parts_mut(place, count) });
        // SAFETY: the same; and nothing changes these.
        Ok(Some(with(own, places.map(|(place, count)| unsafe { slice::from_raw_parts(place, count) }))))
    }

    /// Where the values of some parts are mapped, and how many there are.
    fn places<T: Pod, const N: usize>(
        &self,
        parts: [BufferSlice; N],
    ) -> Result<Option<[(*mut T, usize); N]>> {
        let mut places = [(std::ptr::null_mut(), 0); N];
        for (to, BufferSlice { buffer, offset, bytes }) in places.iter_mut().zip(parts) {
            buffer.check(self, offset, bytes)?;
            buffer.check_aligned(offset, bytes, size_of::<T>() as u64)?;
            let coherent = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
            let shared = self.host_works() && buffer.properties().contains(coherent);
            let Some(start) = buffer.start().filter(|start| shared && start.cast::<T>().is_aligned()) else {
                return Ok(None);
            };
            // In the buffer, as was checked.
            *to = (start.as_ptr().wrapping_add(offset as usize).cast(), bytes as usize / size_of::<T>());
        }
        Ok(Some(places))
    }
}

/// Calls `work` as compiled for the vectors of this CPU, where it is inlined: mark it, and all that it calls, as such. The same
/// results as without: sums and products are not fused.
#[inline(always)]
pub fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        if std::is_x86_feature_detected!("avx2") {
            // SAFETY: the CPU has these instructions.
            return unsafe { wide(work) };
        }
    }
    work()
}

#[cfg(test)]
mod tests {
    use super::super::{Buffer, BufferKind, DeviceOptions};
    use super::*;

    #[test]
    fn host_and_device_see_the_same_memory() {
        let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
        let buffer = |label| Buffer::new(&device, label, 4096, BufferKind::Storage).expect("a buffer");
        let (x, y) = (buffer("x"), buffer("y"));
        let values: Vec<f32> = (0..1024).map(|k| k as f32).collect();
        device.upload_slice(&x, 0, &values).expect("an upload");
        device.upload_slice(&y, 0, &values).expect("an upload");
        let add =
            |[y]: [&mut [f32]; 1], [x]: [&[f32]; 1]| y.iter_mut().zip(x).for_each(|(y, x)| *y += 2.0 * x);
        let added = device.edit_on_host([y.slice(1024, 2048)], [x.slice(1024, 2048)], add).expect("parts");
        if !device.host_works() {
            assert!(added.is_none());
            return;
        }
        added.expect("shared memory");
        let found: Vec<f32> = device.download_slice(&y, 0, 1024).expect("a download");
        for (k, found) in found.into_iter().enumerate() {
            assert_eq!(found, if (256..768).contains(&k) { 3.0 } else { 1.0 } * k as f32);
        }
        let sum = |[x]: [&[f32]; 1]| x.iter().sum::<f32>();
        assert_eq!(device.read_on_host([x.slice(0, 16)], sum).expect("a part"), Some(6.0));

        // No two views of what one of them may change, and nothing outside of a buffer.
        assert!(device.edit_on_host([y.slice(0, 64)], [y.slice(60, 64)], add).expect("parts").is_none());
        assert!(device.edit_on_host([y.slice(0, 64)], [y.slice(64, 64)], add).expect("parts").is_some());
        assert!(device.read_on_host([x.slice(4092, 8)], sum).is_err());
        assert!(device.read_on_host([x.slice(2, 8)], sum).is_err());
        let kernels_only = device.clone().kernels_only();
        assert!(kernels_only.read_on_host([x.slice(0, 16)], sum).expect("a part").is_none());
    }
}
