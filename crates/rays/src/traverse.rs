//! The way of a ray through a hierarchy.

use super::frame::Frame;
use super::lanes::{Instructions, Lanes};
use super::leaf::Leaf;
use super::nodes::Node;
use super::numbering::{LEAF, WIDTH};
use super::ray::{Hit, Ray, Way};
use std::cell::Cell;

/// What rays pass through.
#[derive(Clone, Copy)]
pub struct Among<'a> {
    pub nodes: &'a [Node],
    pub leaves: &'a [Leaf],
    /// That of nodes and leaves.
    pub frame: &'a Frame,
    /// Of all triangles.
    pub corners: &'a [[[f64; 3]; 3]],
    /// The least distance of hits, m.
    pub epsilon: f64,
}

/// Branches for later, with their distances in the upper half: at most seven of each of [`LEVELS`](super::binned::LEVELS), which is less than 256.
type Stack = [u64; 256];
const _: () = assert!((WIDTH - 1) * (super::binned::LEVELS as usize) < 256);

thread_local! {
    /// The stack of the last ray: a new one is slower to clear than the way of many a ray.
    static STACK: Cell<Option<Box<Stack>>> = const { Cell::new(None) };
}

/// Components of directions are not below this: their inverse times any coordinate is finite.
const LEAST: f32 = 1e-18;

/// Calls `call` with all triangles, but for some to `skip`, that a ray meets up to a limit, m, and maybe with others that it meets; if `ORDERED`, roughly from near to
/// far. The limit is the last that a call returned; below zero nothing more is called.
#[inline(always)]
pub fn traverse<I: Instructions, const ORDERED: bool>(
    instructions: I,
    among: Among,
    way: Way,
    limit: f64,
    skip: impl Fn(u32) -> bool,
    mut call: impl FnMut(u32, Hit) -> Option<f64>,
) {
    let Some(ray) = Ray::new(among.frame, way) else { return };
    let mut stack = STACK.take().unwrap_or_else(|| Box::new([0; 256]));
    let splat =
        |of: [f32; 3]| [instructions.splat(of[0]), instructions.splat(of[1]), instructions.splat(of[2])];
    let inverse = ray.direction.map(
        #[inline(always)]
        |x| 1.0 / if x.abs() < LEAST { LEAST.copysign(x) } else { x },
    );
    let [begin, direction] = [splat(ray.begin), splat(ray.direction)];
    let boxes = Slabs {
        near: inverse.map(
            #[inline(always)]
            |x| usize::from(x < 0.0),
        ),
        shift: splat([ray.begin[0] * inverse[0], ray.begin[1] * inverse[1], ray.begin[2] * inverse[2]]),
        inverse: splat(inverse),
    };
    let mut limit = ray.limit(limit);
    let (mut top, mut current) = (0u8, 0u32);
    'ray: loop {
        if current & LEAF == 0 {
            let node = &among.nodes[current as usize];
            let (mut met, entries) = boxes.met(instructions, node, limit);
            let entries = entries.to_array();
            // Distances are not negative, and so ordered as their bits are.
            let next = |k: usize| u64::from(entries[k].to_bits()) << 32 | u64::from(node.branches[k]);
            if met != 0 {
                let mut first = next(lowest(met));
                met &= met - 1;
                let bottom = top;
                while met != 0 {
                    let other = next(lowest(met));
                    met &= met - 1;
                    // The nearest is next, the others are kept, the farthest first.
                    let kept = first.max(other);
                    first = first.min(other);
                    let mut at = top;
                    if ORDERED {
                        while at > bottom && stack[usize::from(at - 1)] < kept {
                            stack[usize::from(at)] = stack[usize::from(at - 1)];
                            at -= 1;
                        }
                    }
                    stack[usize::from(at)] = kept;
                    top += 1;
                }
                current = first as u32;
                continue;
            }
        } else {
            let leaf = &among.leaves[(current & !LEAF) as usize];
            let mut met = meets(instructions, leaf, (begin, direction), limit);
            while met != 0 {
                let triangle = leaf.triangles[lowest(met)];
                met &= met - 1;
                if skip(triangle) {
                    continue;
                }
                let hit = ray.hit(&among.corners[triangle as usize], among.epsilon);
                if let Some(next) = hit.and_then(
                    #[inline(always)]
                    |hit| call(triangle, hit),
                ) {
                    limit = ray.limit(next);
                    if limit < 0.0 {
                        break 'ray;
                    }
                }
            }
        }
        loop {
            if top == 0 {
                break 'ray;
            }
            top -= 1;
            let next = stack[usize::from(top)];
            current = next as u32;
            if !ORDERED || f32::from_bits((next >> 32) as u32) <= limit {
                break;
            }
        }
    }
    STACK.set(Some(stack));
}

/// The lowest bit that is set.
#[inline(always)]
fn lowest(bits: u32) -> usize {
    bits.trailing_zeros() as usize % WIDTH
}

/// What all boxes need to know of a ray.
struct Slabs<L> {
    /// Which side of each axis the ray meets first.
    near: [usize; 3],
    /// One over the direction, and that times where the ray begins.
    inverse: [L; 3],
    shift: [L; 3],
}

impl<L: Lanes> Slabs<L> {
    /// The boxes that the ray meets up to a limit, as bits, and how far it is to each.
    #[inline(always)]
    fn met(&self, instructions: impl Instructions<Lanes = L>, node: &Node, limit: f32) -> (u32, L) {
        let to = |axis: usize, side: usize| {
            instructions.load(&node.bounds[axis][side & 1]).mul_sub(self.inverse[axis], self.shift[axis])
        };
        let [x, y, z] = self.near;
        let enter = to(0, x).max(to(1, y)).max(to(2, z).max(instructions.splat(0.0)));
        let leave = to(0, 1 - x).min(to(1, 1 - y)).min(to(2, 1 - z).min(instructions.splat(limit)));
        (enter.at_most(leave), enter)
    }
}

/// The triangles that a ray may meet up to a limit, as bits (Möller and Trumbore 1997, multiplied by the determinant).
#[inline(always)]
fn meets<I: Instructions>(
    instructions: I,
    leaf: &Leaf,
    (begin, direction): ([I::Lanes; 3], [I::Lanes; 3]),
    limit: f32,
) -> u32 {
    let load = |of: &[[f32; WIDTH]; 3]| {
        [instructions.load(&of[0]), instructions.load(&of[1]), instructions.load(&of[2])]
    };
    let (corner, [e, f]) = (load(&leaf.corner), [load(&leaf.edges[0]), load(&leaf.edges[1])]);
    let p = cross(direction, f);
    let determinant = dot(e, p);
    let s = [begin[0] - corner[0], begin[1] - corner[1], begin[2] - corner[2]];
    let q = cross(s, e);
    let sign = determinant.signs();
    let size = determinant.flip(sign);
    let (u, v, t) = (dot(s, p).flip(sign), dot(direction, q).flip(sign), dot(f, q).flip(sign));
    let inside = u.min(v).min(size - (u + v)) + instructions.load(&leaf.slack);
    let within =
        t.min(size.mul_sub(instructions.splat(limit), t)) + instructions.load(&leaf.slack_of_distance);
    instructions.splat(0.0).at_most(inside.min(within))
}

#[inline(always)]
fn cross<L: Lanes>(a: [L; 3], b: [L; 3]) -> [L; 3] {
    [a[1].mul_sub(b[2], a[2] * b[1]), a[2].mul_sub(b[0], a[0] * b[2]), a[0].mul_sub(b[1], a[1] * b[0])]
}

#[inline(always)]
fn dot<L: Lanes>(a: [L; 3], b: [L; 3]) -> L {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}
