//! Memory that host and device share, as with CPU drivers.

use std::slice;

use ash::vk;
use bytemuck::Pod;

use super::Result;
use super::buffer::BufferSlice;
use super::device::Device;
use super::info::DeviceKind;

impl Device {
    /// Calls `with` with the values of parts of buffers, while nothing runs on the device. `None` unless the device is a CPU,
    /// whose memory is the host's, and not of [`Device::kernels_only`]. `with` must not use the device.
    pub fn read_on_host<T: Pod, R, const N: usize>(
        &self,
        parts: [BufferSlice; N],
        with: impl FnOnce([&[T]; N]) -> R,
    ) -> Result<Option<R>> {
        let Some(places) = self.places(parts)? else { return Ok(None) };
        let _alone = self.shared.running.write();
        // SAFETY: the memory is mapped while the borrowed buffers live, and the lock keeps away everything that writes
        // there: batches that run, and `edit_on_host`. Any bytes are a `T`.
        Ok(Some(with(places.map(|(place, count)| unsafe { slice::from_raw_parts(place, count) }))))
    }

    /// Calls `with` with the values of a part of a buffer, to change them, and of others, while nothing runs on the device.
    /// `None` where the device is no CPU, or the first part overlaps another. `with` must not use the device.
    pub fn edit_on_host<T: Pod, R, const N: usize>(
        &self,
        part: BufferSlice,
        others: [BufferSlice; N],
        with: impl FnOnce(&mut [T], [&[T]; N]) -> R,
    ) -> Result<Option<R>> {
        let (own, places) = (self.places([part])?, self.places(others)?);
        let (Some([(place, count)]), Some(places)) = (own, places) else { return Ok(None) };
        if others.iter().any(|other| other.overlaps(&part)) {
            return Ok(None);
        }
        let _alone = self.shared.running.write();
        // SAFETY: as in `read_on_host`; and nothing else reads or writes the first part, which overlaps no other.
        let own = unsafe { slice::from_raw_parts_mut(place, count) };
        // SAFETY: as in `read_on_host`.
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
            let shared = self.host_works
                && self.info().kind == DeviceKind::Cpu
                && buffer.properties().contains(coherent);
            let Some(start) = buffer.start().filter(|start| shared && start.cast::<T>().is_aligned()) else {
                return Ok(None);
            };
            // In the buffer, as was checked.
            *to = (start.as_ptr().wrapping_add(offset as usize).cast(), bytes as usize / size_of::<T>());
        }
        Ok(Some(places))
    }
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
        let add = |y: &mut [f32], [x]: [&[f32]; 1]| y.iter_mut().zip(x).for_each(|(y, x)| *y += 2.0 * x);
        let added = device.edit_on_host(y.slice(1024, 2048), [x.slice(1024, 2048)], add).expect("parts");
        if device.info().kind != DeviceKind::Cpu {
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
        assert!(device.edit_on_host(y.slice(0, 64), [y.slice(60, 64)], add).expect("parts").is_none());
        assert!(device.edit_on_host(y.slice(0, 64), [y.slice(64, 64)], add).expect("parts").is_some());
        assert!(device.read_on_host([x.slice(4092, 8)], sum).is_err());
        assert!(device.read_on_host([x.slice(2, 8)], sum).is_err());
        let kernels_only = device.clone().kernels_only();
        assert!(kernels_only.read_on_host([x.slice(0, 16)], sum).expect("a part").is_none());
    }
}
