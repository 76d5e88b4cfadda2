//! Conversion between the layouts of values on the device and in the reference.

use antirad::plan::Plan;
use antirad_core::model::Class;
use antirad_core::plan::PADDING;
use antirad_reference::Model;
use glam::DVec3;

pub fn relative(values: &[f64], truth: &[f64]) -> f64 {
    assert_eq!(values.len(), truth.len());
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let size = norm(&mut truth.iter().copied());
    let error = norm(&mut values.iter().zip(truth).map(|(a, b)| a - b));
    if size > 0.0 { error / size } else { error }
}

/// RGB values per slot, of the triangles that have one.
pub fn by_slot(plan: &Plan, values: impl Fn(usize) -> DVec3) -> Vec<[f64; 4]> {
    let value = |&i: &u32| if i == PADDING { DVec3::ZERO } else { values(i as usize) };
    plan.layout().order.iter().map(|i| value(i).extend(0.0).to_array()).collect()
}

/// Flattens what the device holds per slot, in the order of the scene.
pub fn rgb_of(plan: &Plan, slots: &[[f64; 4]]) -> Vec<f64> {
    let mut all = vec![0.0; plan.facets().len() * 3];
    for (&i, value) in plan.layout().order.iter().zip(slots).filter(|(i, _)| **i != PADDING) {
        for c in 0..3 {
            all[i as usize * 3 + c] = value[c];
        }
    }
    all
}

/// Pages of bins as the device holds them, from bins of the reference.
pub fn to_pages(model: &Model, plan: &Plan, bins: &[DVec3]) -> Vec<Option<Vec<f64>>> {
    let channels = plan.channels() as usize;
    let width = model.bins.count() * channels;
    plan.layout()
        .groups
        .iter()
        .map(|group| {
            group.class.has_bins().then(|| {
                let slots = plan.layout().slots_of(&group.tiles);
                let mut page = vec![0.0; slots.len() * width];
                for (row, slot) in page.chunks_mut(width).zip(slots) {
                    let i = plan.layout().order[slot as usize];
                    if i == PADDING {
                        continue;
                    }
                    let Some(range) = model.bins_of(i as usize) else { continue };
                    for (value, rgb) in row.chunks_mut(channels).zip(&bins[range]) {
                        for (c, v) in value.iter_mut().enumerate() {
                            *v = rgb[c];
                        }
                    }
                }
                page
            })
        })
        .collect()
}

/// Flattens pages of the device, in the order of the reference; groups that have none count as zero.
pub fn from_pages(model: &Model, plan: &Plan, pages: &[Option<Vec<f64>>], total: usize) -> Vec<f64> {
    let channels = plan.channels() as usize;
    let width = model.bins.count() * channels;
    let mut all = vec![0.0; total * 3];
    for (group, page) in plan.layout().groups.iter().zip(pages) {
        let Some(page) = page else { continue };
        for (row, slot) in page.chunks(width).zip(plan.layout().slots_of(&group.tiles)) {
            let i = plan.layout().order[slot as usize];
            let Some(range) = (i != PADDING).then(|| model.bins_of(i as usize)).flatten() else { continue };
            for (b, value) in range.zip(row.chunks(channels)) {
                for c in 0..3 {
                    all[b * 3 + c] = value[if channels == 1 { 0 } else { c }];
                }
            }
        }
    }
    all
}

pub fn flat(rgb: &[DVec3]) -> Vec<f64> {
    rgb.iter().flat_map(|v| v.to_array()).collect()
}

/// Masks bins by class: the reference computes both kinds for every triangle with bins.
pub fn of_class(model: &Model, bins: &[DVec3], selected: impl Fn(Class) -> bool) -> Vec<f64> {
    let mut kept = vec![DVec3::ZERO; bins.len()];
    for (i, &class) in model.classes.iter().enumerate() {
        if let Some(range) = model.bins_of(i).filter(|_| selected(class)) {
            kept[range.clone()].copy_from_slice(&bins[range]);
        }
    }
    flat(&kept)
}
