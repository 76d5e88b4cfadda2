//! Buffers, their budget, and transfers.

use antirad::gpu::{Device, GpuError, staging_bytes};
use antirad_gpu as gpu;
use antirad_gpu::{ALIGN, Batch, BatchTiming, Buffer, BufferKind, STAGING_CHUNK};

use crate::{device, finish, options};

#[test]
fn transfers_beyond_one_staging_chunk() {
    let device = device();
    let bytes = STAGING_CHUNK as usize * 2 + 12_345;
    let data: Vec<u8> = (0..bytes).map(|i| (i * 31 + i / 251) as u8).collect();
    let buffer = Buffer::new(&device, "big", bytes as u64 + 100, BufferKind::Storage).unwrap();
    device.upload(&buffer, 77, &data).unwrap();
    assert!(device.download(&buffer, 77, bytes as u64).unwrap() == data);
    // A part of it, into the caller's memory.
    let mut part = vec![0; 1000];
    device.download_into(&buffer, 77 + STAGING_CHUNK - 500, &mut part).unwrap();
    assert!(part == data[STAGING_CHUNK as usize - 500..][..1000]);

    let report = device.memory();
    let staging = report.by_label.iter().filter(|row| row.label.starts_with("staging"));
    assert_eq!(staging.map(|row| row.bytes).sum::<u64>(), gpu::staging_bytes());
    assert!(report.reserved >= report.in_use);

    // Another user of the device has staging buffers of another size: more pieces, the same bytes.
    let before = device.memory().in_use;
    let other = device.scope(100_000);
    assert!(other.download(&buffer, 77, bytes as u64).unwrap() == data);
    other.upload(&buffer, 0, &data).unwrap();
    assert!(other.download(&buffer, 0, bytes as u64).unwrap() == data);
    assert!(device.download(&buffer, 0, bytes as u64).unwrap() == data);
    let of = |device: &Device| {
        device.scope_memory().into_iter().map(|row| (row.label, row.bytes)).collect::<Vec<_>>()
    };
    let staging = |bytes| [("staging readback".to_owned(), bytes), ("staging upload".to_owned(), bytes)];
    assert_eq!(of(&other), staging(gpu::rounded(50_000)));
    assert_eq!(of(&device)[1..], staging(STAGING_CHUNK));
    assert_eq!(device.memory().in_use, before + 2 * gpu::rounded(50_000));
    drop(other);
    assert_eq!(device.memory().in_use, before);

    let beyond = device.download(&buffer, buffer.bytes() - 4, 8);
    assert!(matches!(beyond, Err(GpuError::OutOfRange { .. })));
    let beyond = device.upload_slice(&buffer, u64::MAX, &[1u8]);
    assert!(matches!(beyond, Err(GpuError::OutOfRange { .. })));
    let beyond = device.download_slice::<u64>(&buffer, 0, u64::MAX);
    assert!(matches!(beyond, Err(GpuError::OutOfRange { .. })));
    device.upload(&buffer, buffer.bytes(), &[]).unwrap();
    drop(buffer);
    finish(device);
}

/// However large staging buffers are asked for, they are no larger than the device allows.
#[test]
fn staging_keeps_to_the_largest_buffer() {
    let device = Device::new(&options().memory_budget(Some(u64::MAX))).unwrap();
    let largest = device.info().largest_buffer() / ALIGN * ALIGN;
    let greedy = device.scope(u64::MAX);
    let buffer = Buffer::new(&greedy, "some", 1000, BufferKind::Storage).unwrap();
    greedy.upload(&buffer, 3, &[1, 2, 3]).unwrap();
    let rows = greedy.scope_memory();
    let staging = rows.iter().find(|row| row.label == "staging upload").unwrap();
    assert_eq!((staging.bytes, staging.count), (largest, 1));
    drop((buffer, greedy));
    finish(device);
}

/// Parts of buffers are read with the batch that writes them, in its submission; where the staging buffer is too small, after it.
#[test]
fn a_batch_is_read_when_it_ends() {
    let device = device();
    for (staging, submissions) in [(2048, 1), (512, 4)] {
        let small = device.scope(staging);
        let buffer = |label| Buffer::new(&small, label, 512, BufferKind::Storage).unwrap();
        let (one, other) = (buffer("one"), buffer("other"));
        let filled = || {
            let mut batch = small.batch().unwrap();
            batch.fill(&one, 0, 512, 0x0101_0101).unwrap();
            batch.fill(&other, 0, 256, 0x0202_0202).unwrap();
            batch
        };
        let before = device.submissions();
        let (read, timing) = filled().submit_and_read(&[one.slice(0, 400), other.slice(4, 8)]).unwrap();
        assert!(timing.wall_seconds > 0.0);
        assert_eq!(read, [vec![1; 400], vec![2; 8]]);
        assert_eq!(device.submissions() - before, submissions, "{staging} bytes of staging");
        let beyond = filled().submit_and_read(&[one.slice(0, 4), other.slice(508, 8)]);
        assert!(matches!(beyond, Err(GpuError::OutOfRange { .. })));
    }
    finish(device);
}

/// A batch sets values in its order, more of them than Vulkan takes at a time, too.
#[test]
fn a_batch_carries_values() {
    let device = device();
    let values: Vec<u8> = (0..150_000).map(|k| (k % 251) as u8).collect();
    let buffer = Buffer::new(&device, "values", 160_000, BufferKind::Storage).unwrap();
    let mut batch = device.batch().unwrap();
    batch.fill(&buffer, 0, 160_000, 0).unwrap();
    batch.update(&buffer, 8, &values).unwrap();
    batch.update(&buffer, 16, &[9; 4]).unwrap();
    batch.update(&buffer, 0, &[]).unwrap();
    assert!(matches!(batch.update(&buffer, 6, &[1; 4]), Err(GpuError::Misaligned { .. })));
    assert!(matches!(batch.update(&buffer, 1 << 20, &[1; 4]), Err(GpuError::OutOfRange { .. })));
    batch.submit().unwrap();
    let found = device.download(&buffer, 0, 160_000).unwrap();
    assert!(found[16..20] == [9; 4] && found[20..150_008] == values[12..]);
    assert!(found[..8].iter().chain(&found[150_008..]).all(|&byte| byte == 0) && found[8..16] == values[..8]);
    finish(device);
}

#[test]
fn mapped_buffers_need_no_staging() {
    let device = device();
    let mut upload = Buffer::new(&device, "up", 1024, BufferKind::Upload).unwrap();
    let mut readback = Buffer::new(&device, "down", 1024, BufferKind::Readback).unwrap();
    upload.mapped().unwrap().fill(7);
    let mut batch = device.batch().unwrap();
    batch.fill(&readback, 0, 1024, 0x0101_0101).unwrap();
    batch.copy(&upload, 0, &readback, 256, 512).unwrap();
    batch.submit().unwrap();
    let bytes = readback.mapped().unwrap();
    assert!(bytes[..256].iter().chain(&bytes[768..]).all(|&byte| byte == 1));
    assert!(bytes[256..768].iter().all(|&byte| byte == 7));
    drop((upload, readback));
    finish(device);
}

#[test]
fn budget_refuses_by_name_and_freed_memory_is_uncounted() {
    let budget = gpu::staging_bytes() + (1 << 20);
    let device = Device::new(&options().memory_budget(Some(budget))).unwrap();
    let buffer = |label: &str, bytes| Buffer::new(&device, label, bytes, BufferKind::Storage).map(drop);
    let small = Buffer::new(&device, "small", 100, BufferKind::Storage).unwrap();
    assert_eq!((small.bytes(), device.memory().in_use), (ALIGN, ALIGN));

    let error = buffer("too much", budget).unwrap_err();
    assert!(matches!(error, GpuError::OverBudget { .. }));
    let text = error.to_string();
    assert!(text.contains("too much") && text.contains(&budget.to_string()), "{text}");
    let report = device.memory();
    assert_eq!((report.budget, report.in_use, report.peak), (budget, ALIGN, ALIGN));

    // Exactly the rest of the budget can be allocated, and is returned.
    buffer("rest", budget - ALIGN).unwrap();
    let report = device.memory();
    assert_eq!((report.in_use, report.peak), (ALIGN, budget));
    assert_eq!(report.by_label.len(), 1);
    let row = &report.by_label[0];
    assert_eq!((row.label.as_str(), row.bytes, row.count), ("small", ALIGN, 1));

    // Empty buffers are possible, and the device still works.
    let empty = Buffer::new(&device, "empty", 0, BufferKind::Storage).unwrap();
    assert_eq!(empty.bytes(), ALIGN);
    device.upload(&empty, 0, &[1, 2, 3]).unwrap();
    assert_eq!(device.download(&empty, 0, 3).unwrap(), [1, 2, 3]);
    drop((small, empty));
    finish(device);
}

#[test]
fn buffers_beyond_the_binding_limit_are_refused() {
    let device = Device::new(&options().memory_budget(Some(u64::MAX))).unwrap();
    for bytes in [device.info().largest_buffer() + 1, u64::MAX] {
        let error = Buffer::new(&device, "huge", bytes, BufferKind::Storage).err().unwrap();
        assert!(matches!(error, GpuError::BufferTooLarge { .. }));
        assert!(error.to_string().contains("huge"));
    }
    assert_eq!(device.memory().in_use, 0);
    finish(device);
}

/// A batch that waits is executed with whatever uses its buffers next, before it, and keeps them alive until then.
#[test]
fn batches_wait_for_the_next_use_of_their_buffers() {
    let device = device();
    let [own, others] = [(); 2].map(|()| device.scope(staging_bytes()));
    let buffer = |of: &Device, label| Buffer::new(of, label, 512, BufferKind::Storage).unwrap();
    let (x, y, foreign) = (buffer(&own, "x"), buffer(&own, "y"), buffer(&others, "foreign"));
    let submissions = || device.submissions();
    let defer = |record: &dyn Fn(&mut Batch)| {
        let mut batch = own.batch().unwrap();
        record(&mut batch);
        batch.defer().unwrap();
    };

    // Three of them and a download are one submission.
    let before = submissions();
    defer(&|batch| batch.fill(&x, 0, 512, 0x0101_0101).unwrap());
    defer(&|batch| batch.copy(&x, 0, &y, 0, 256).unwrap());
    defer(&|_| {});
    defer(&|batch| batch.fill(&x, 0, 4, 0x0202_0202).unwrap());
    assert!(own.anything_waits() && !others.anything_waits());
    // Others do not make it run.
    others.upload(&foreign, 0, &[7; 512]).unwrap();
    assert_eq!(submissions() - before, 1);
    assert_eq!(own.download(&x, 0, 8).unwrap(), [2, 2, 2, 2, 1, 1, 1, 1]);
    assert_eq!(submissions() - before, 2);
    assert!(!own.anything_waits());
    assert_eq!(own.download(&y, 0, 256).unwrap(), [1; 256]);

    // An upload comes after it, and so does another batch, and what reads the buffer with the handle of another scope.
    defer(&|batch| batch.fill(&x, 0, 512, 0x0303_0303).unwrap());
    own.upload(&x, 0, &[9; 4]).unwrap();
    defer(&|batch| batch.copy(&x, 0, &y, 0, 512).unwrap());
    let mut batch = others.batch().unwrap();
    batch.copy(&y, 0, &foreign, 256, 256).unwrap();
    batch.submit().unwrap();
    let found = others.download(&foreign, 0, 512).unwrap();
    assert!(found[..256] == [7; 256] && found[256..260] == [9; 4] && found[260..] == [3; 252]);

    // One that uses buffers of two scopes is executed at once, and so are very many.
    let before = submissions();
    defer(&|batch| batch.copy(&x, 0, &foreign, 0, 512).unwrap());
    assert!(submissions() > before && !own.anything_waits());
    (0..200).for_each(|_| defer(&|batch| batch.fill(&x, 0, 512, 6).unwrap()));
    assert!((1..=4).contains(&(submissions() - before - 1)));
    assert!(own.execute_waiting().unwrap().wall_seconds > 0.0);
    assert_eq!(own.execute_waiting().unwrap(), BatchTiming::default());

    // Buffers live until it has ended.
    let taken = || device.memory().in_use;
    let with_both = taken();
    defer(&|batch| batch.copy(&x, 0, &y, 0, 512).unwrap());
    drop((x, y));
    assert_eq!(taken(), with_both);
    own.execute_waiting().unwrap();
    assert!(taken() < with_both);
    // Or until nobody can read its result.
    let z = buffer(&own, "z");
    let mut batch = own.batch().unwrap();
    batch.fill(&z, 0, 512, 0).unwrap();
    batch.defer().unwrap();
    drop((z, own, foreign, others));
    assert_eq!(taken(), 0);
    finish(device);
}
