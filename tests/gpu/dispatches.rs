//! Pipelines, batches and their timing.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use antirad::gpu::{Device, DeviceOptions, GpuError};
use antirad::scene::Precision;
use antirad_core::shaders;
use antirad_gpu as gpu;
use antirad_gpu::{ALIGN, Bindings, Buffer, BufferKind, Pipeline};

use crate::{AXPY_PUSH, Axpy, axpy, axpy_pipeline, device, filled, finish, ramp};

#[test]
fn axpy_computes_and_is_profiled_by_shape() {
    let device = device();
    let pipeline = axpy_pipeline(&device);
    let (xs, ys) = (ramp(10_001), vec![0.5; 10_001]);
    let (x, y) = (filled(&device, "x", &xs), filled(&device, "y", &ys));
    let push = Axpy { count: 10_001, a: 2.0, b: 1.0 };
    device.reset_profile();
    let mut batch = device.batch().unwrap();
    for shape in ["first", "again", "again"] {
        // Fewer groups than elements: the grid-stride loop covers the rest.
        let buffers = [x.whole(), y.whole()];
        batch.dispatch(&pipeline, shape, &buffers, bytemuck::bytes_of(&push), [3, 1, 1]).unwrap();
    }
    let timing = batch.submit().unwrap();
    assert_eq!(device.download_slice::<f32>(&y, 0, 10_001).unwrap(), axpy(6.0, &xs, &ys));

    assert_eq!(timing.dispatches, 3);
    assert!(timing.wall_seconds > 0.0);
    let mut rows = device.profile();
    rows.sort_by(|a, b| a.shape.cmp(&b.shape));
    let key = |row: &gpu::ProfileRow| (row.kernel.clone(), row.shape.clone(), row.count);
    let keys: Vec<_> = rows.iter().map(key).collect();
    assert_eq!(keys, [("combine".into(), "again".into(), 2), ("combine".into(), "first".into(), 1)]);
    let total: f64 = rows.iter().map(|row| row.seconds).sum();
    assert!((total - timing.device_seconds).abs() <= 1e-12);
    if device.info().timestamp_period_ns > 0.0 {
        assert!(rows.iter().all(|row| row.seconds > 0.0), "{rows:?}");
        assert!(timing.device_seconds <= timing.wall_seconds, "{timing:?}");
    }
    device.reset_profile();
    assert!(device.profile().is_empty());
    drop((pipeline, x, y));
    finish(device);
}

#[test]
fn slices_bind_a_part_and_leave_the_rest() {
    let device = device();
    let pipeline = axpy_pipeline(&device);
    let (xs, ys) = (ramp(512), ramp(512));
    let (x, y) = (filled(&device, "x", &xs), filled(&device, "y", &ys));
    let push = Axpy { count: 64, a: 3.0, b: 1.0 };
    let push = bytemuck::bytes_of(&push);
    let mut batch = device.batch().unwrap();
    let buffers = [x.slice(ALIGN, 256), y.slice(2 * ALIGN, 256)];
    batch.dispatch(&pipeline, "64", &buffers, push, [2, 1, 1]).unwrap();

    let refused = [x.slice(ALIGN, 2048), x.slice(4096, 256), x.slice(0, 0)];
    for slice in refused {
        let refused = batch.dispatch(&pipeline, "64", &[slice, y.whole()], push, [1, 1, 1]);
        assert!(matches!(refused, Err(GpuError::OutOfRange { .. })));
    }
    let refused = batch.dispatch(&pipeline, "64", &[x.slice(1, 64), y.whole()], push, [1, 1, 1]);
    if device.info().storage_buffer_alignment > 1 {
        assert!(matches!(refused, Err(GpuError::Misaligned { .. })));
    }
    let refused = batch.fill(&x, 2, 4, 0);
    assert!(matches!(refused, Err(GpuError::Misaligned { .. })));
    let refused = batch.copy(&x, 0, &x, 100, 101);
    assert!(matches!(refused, Err(GpuError::Overlap { .. })));
    // A refused operation leaves the batch unchanged.
    batch.copy(&x, 0, &x, 1024, 1024).unwrap();
    batch.submit().unwrap();

    let mut expected = ys.clone();
    expected[128..192].copy_from_slice(&axpy(3.0, &xs[64..128], &ys[128..192]));
    assert_eq!(device.download_slice::<f32>(&y, 0, 512).unwrap(), expected);
    assert_eq!(device.download_slice::<f32>(&x, 1024, 256).unwrap(), xs[..256]);
    drop((pipeline, x, y));
    finish(device);
}

/// Uniform buffers are aligned as any device may require, not only this one.
#[test]
fn uniform_buffers_are_checked() {
    let device = device();
    let limit = device.info().max_uniform_buffer_range;
    assert!(limit >= 1 << 16 && ALIGN.is_multiple_of(device.info().uniform_buffer_alignment));
    let shader = shaders::TRANSPORT_IRRADIANCE.of(Precision::F32);
    let pipeline = Pipeline::new(&device, shader, Bindings { storage: 3, uniform: 2 }, 32, &[]).unwrap();
    let storage = filled(&device, "storage", &[0.0]);
    let uniform = Buffer::new(&device, "uniform", limit + 2 * ALIGN, BufferKind::Storage).unwrap();
    let mut batch = device.batch().unwrap();
    let mut refused = |offset, bytes| {
        let (whole, part) = (storage.whole(), uniform.slice(offset, bytes));
        let buffers = [whole, whole, whole, uniform.slice(ALIGN, limit), part];
        batch.dispatch(&pipeline, "", &buffers, &[0; 32], [0, 1, 1]).err()
    };
    for offset in [16, 64, 128, ALIGN + 128] {
        let error = refused(offset, 256);
        assert!(matches!(&error, Some(GpuError::Misaligned { alignment: ALIGN, .. })), "{offset}: {error:?}");
    }
    assert!(matches!(refused(0, limit + 4), Some(GpuError::BufferTooLarge { .. })));
    assert!(matches!(refused(4 * ALIGN, limit), Some(GpuError::OutOfRange { .. })));
    assert!(refused(ALIGN, 256).is_none());
    batch.submit().unwrap();
    drop((pipeline, storage, uniform));
    finish(device);
}

#[test]
fn pipelines_and_dispatches_are_checked() {
    let device = device();
    let new = |bindings, push| {
        Pipeline::new(&device, shaders::COMBINE.of(Precision::F32), bindings, push, &[]).err()
    };
    assert!(matches!(new(2, 132), Some(GpuError::PushTooLarge { bytes: 132, .. })));
    assert!(matches!(new(2, 6), Some(GpuError::PushTooLarge { .. })));
    assert!(matches!(new(1000, AXPY_PUSH), Some(GpuError::TooManyBindings { .. })));
    assert!(new(2, AXPY_PUSH).is_none());

    let pipeline = axpy_pipeline(&device);
    let x = filled(&device, "x", &[0.0]);
    let other = filled(&self::device(), "other", &[0.0]);
    let push = [0; AXPY_PUSH as usize];
    let mut batch = device.batch().unwrap();
    let mut dispatch = |buffers: &[_], push: &[u8], groups| {
        batch.dispatch(&pipeline, "", buffers, push, groups).unwrap_err()
    };
    let one = [1, 1, 1];
    let error = dispatch(&[x.whole()], &push, one);
    assert!(matches!(error, GpuError::WrongArguments { given: 1, wanted: 2, .. }));
    let error = dispatch(&[x.whole(), x.whole()], &push[1..], one);
    assert!(matches!(error, GpuError::WrongArguments { given: 11, wanted: 12, .. }));
    let error = dispatch(&[x.whole(), x.whole()], &push, [1, u32::MAX, 1]);
    assert!(matches!(error, GpuError::TooManyGroups { .. }));
    let error = dispatch(&[x.whole(), other.whole()], &push, one);
    assert!(matches!(error, GpuError::OtherDevice { .. }));
    drop(batch);
    drop((pipeline, x, other));
    finish(device);
}

#[test]
fn long_batches_are_executed_in_parts() {
    let device = device();
    let pipeline = axpy_pipeline(&device);
    let (x, y) = (filled(&device, "x", &ramp(100)), filled(&device, "y", &[0.0; 100]));
    let push = Axpy { count: 100, a: 1.0, b: 1.0 };
    let mut batch = device.batch().unwrap();
    for _ in 0..1000 {
        let buffers = [x.whole(), y.whole()];
        batch.dispatch(&pipeline, "100", &buffers, bytemuck::bytes_of(&push), [1, 1, 1]).unwrap();
    }
    assert_eq!(batch.submit().unwrap().dispatches, 1000);
    let expected = axpy(1000.0, &ramp(100), &[0.0; 100]);
    assert_eq!(device.download_slice::<f32>(&y, 0, 100).unwrap(), expected);
    drop((pipeline, x, y));
    finish(device);
}

#[test]
fn thousands_of_submits_neither_leak_nor_crawl() {
    let device = device();
    let pipeline = axpy_pipeline(&device);
    let (x, y) = (filled(&device, "x", &ramp(100)), filled(&device, "y", &[0.0; 100]));
    let push = Axpy { count: 100, a: 1.0, b: 1.0 };
    let before = device.memory();
    let mut seconds = Vec::with_capacity(2000);
    for _ in 0..2000 {
        let start = Instant::now();
        let mut batch = device.batch().unwrap();
        let buffers = [x.whole(), y.whole()];
        batch.dispatch(&pipeline, "100", &buffers, bytemuck::bytes_of(&push), [1, 1, 1]).unwrap();
        batch.submit().unwrap();
        seconds.push(start.elapsed().as_secs_f64());
    }
    // The fastest of many gives the cost of a submission on a busy machine. A leak would slow down all of the last
    // ones.
    let fastest = |some: &[f64]| some.iter().copied().fold(f64::INFINITY, f64::min);
    let (first, last) = (fastest(&seconds[..500]), fastest(&seconds[1500..]));
    println!("{:.0} µs per submission at first, {:.0} µs at last", 1e6 * first, 1e6 * last);
    assert!(last <= 3.0 * first, "{last} s after {first} s");
    assert_eq!(device.memory(), before);
    let expected = axpy(2000.0, &ramp(100), &[0.0; 100]);
    assert_eq!(device.download_slice::<f32>(&y, 0, 100).unwrap(), expected);
    drop((pipeline, x, y));
    finish(device);
}

#[test]
fn threads_share_a_device() {
    let device = device();
    let pipeline = axpy_pipeline(&device);
    thread::scope(|scope| {
        for thread in 1..=4 {
            let (device, pipeline) = (&device, &pipeline);
            scope.spawn(move || {
                let a = thread as f32;
                for round in 0..20 {
                    let count = 1000 + 97 * round;
                    let (xs, ys) = (ramp(count), vec![a; count]);
                    let (x, y) = (filled(device, "x", &xs), filled(device, "y", &ys));
                    let push = Axpy { count: count as u32, a, b: 1.0 };
                    let push = bytemuck::bytes_of(&push);
                    let mut batch = device.batch().unwrap();
                    let buffers = [x.whole(), y.whole()];
                    batch.dispatch(pipeline, "thread", &buffers, push, [4, 1, 1]).unwrap();
                    batch.submit().unwrap();
                    let result: Vec<f32> = device.download_slice(&y, 0, count as u64).unwrap();
                    assert_eq!(result, axpy(a, &xs, &ys));
                }
            });
        }
    });
    let rows = device.profile();
    assert_eq!((rows.len(), rows[0].count), (1, 80));
    drop(pipeline);
    let labels: Vec<_> = device.memory().by_label.into_iter().map(|row| row.label).collect();
    assert_eq!(labels, ["staging readback", "staging upload"]);
    finish(device);
}

#[test]
fn a_watch_is_asked_before_a_kernel_is_compiled() {
    let asked = Arc::new(AtomicUsize::new(0));
    let count = asked.clone();
    let watch: antirad::Watch = Arc::new(move || match count.fetch_add(1, Ordering::SeqCst) {
        0 => ControlFlow::Continue(()),
        _ => ControlFlow::Break(()),
    });
    let options = DeviceOptions::default().validation(true).kernel_cache(None);
    let device = Device::new(&options).expect("a Vulkan device").with_watch(watch);
    let kernel = |lanes: u32| {
        let shader = shaders::COMBINE.of(Precision::F32);
        Pipeline::new(&device.scope(0), shader, 2, AXPY_PUSH, &[(0, lanes)])
    };
    assert!(kernel(32).is_ok());
    assert!(matches!(kernel(64), Err(GpuError::Interrupted)));
    // There already.
    assert!(kernel(32).is_ok());
    assert_eq!(asked.load(Ordering::SeqCst), 2);
    assert_eq!(device.validation_messages(), Vec::<String>::new());
}
