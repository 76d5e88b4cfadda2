//! Rectangles in a rectangle, none over another.

use guillotiere::{SimpleAtlasAllocator, size2};

/// The corners nearest to the origin of rectangles of whole sizes, packed into one of another size; `None` if they do not fit.
pub(super) fn pack(sizes: &[[u32; 2]], into: [u32; 2]) -> Option<Vec<[u32; 2]>> {
    let area = |[width, height]: [u32; 2]| u64::from(width) * u64::from(height);
    if sizes.iter().any(|size| size[0] > into[0] || size[1] > into[1])
        || sizes.iter().map(|&size| area(size)).sum::<u64>() > area(into)
    {
        return None;
    }
    let longest = |k: &usize| (sizes[*k].into_iter().max(), sizes[*k].into_iter().min());
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|k| std::cmp::Reverse(longest(k)));
    let size = |[width, height]: [u32; 2]| size2(width as i32, height as i32);
    let mut allocator = SimpleAtlasAllocator::new(size(into));
    let mut places = vec![[0; 2]; sizes.len()];
    for k in order {
        let corner = allocator.allocate(size(sizes[k]))?.min;
        places[k] = [corner.x as u32, corner.y as u32];
    }
    Some(places)
}
