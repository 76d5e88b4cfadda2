//! Direction bins of several directions at a time: the four taps of T_b(ω) and their weights. Twin of glsl/bins.glsl.

use super::real::Real;
use crate::plan::Plan;
use crate::scene::{BinLayout, Weights};
use std::f64::consts::{FRAC_1_PI, FRAC_2_PI};

/// A partition of the hemisphere.
#[derive(Clone, Copy)]
pub struct Layout<T> {
    concentric: bool,
    smoothstep: bool,
    rows: T,
    columns: T,
    /// Of memory: 3, or 1 for a scene without colour.
    pub channels: usize,
    /// Number of bins.
    pub count: usize,
    stride: usize,
}

impl<T: Real> Layout<T> {
    pub fn of(plan: &Plan) -> Self {
        let (concentric, rows, columns) = match plan.settings.bins {
            BinLayout::EqualAngle { theta, phi } => (false, theta, phi),
            BinLayout::Concentric { n } => (true, n, n),
        };
        Self {
            concentric,
            smoothstep: plan.settings.weights == Weights::Smoothstep,
            rows: T::of(rows.into()),
            columns: T::of(columns.into()),
            channels: plan.channels as usize,
            count: plan.bins.count(),
            stride: columns as usize,
        }
    }

    #[inline(always)]
    fn shape(&self, t: T) -> T {
        if self.smoothstep { t * t * (T::of(3.0) - T::of(2.0) * t) } else { t }
    }

    /// The first of the two cells around a coordinate, whose centres are 0, 1, … count - 1, and the weight of the second.
    #[inline(always)]
    fn between(&self, coordinate: T, count: T) -> (T, T) {
        let coordinate = coordinate.most(T::ZERO).least(count - T::ONE);
        let first = coordinate.whole().least(count - T::of(2.0));
        (first, self.shape(coordinate - first))
    }

    /// Row and column of the first tap, that of the next column from there, and the weights of the second row and column.
    /// `w`: unit, in the frame of the triangle; directions below the horizon count as on it.
    #[inline(always)]
    fn equal_angle(&self, [x, y, z]: [T; 3]) -> [T; 5] {
        let polar = z.clamped().arccosine() * T::of(FRAC_2_PI);
        let (row, t) = self.between(polar * self.rows - T::of(0.5), self.rows);
        let level = x * x + y * y > T::POLE * T::POLE;
        let (x, y) = (if level { x } else { T::ZERO }, if level { y } else { T::ZERO });
        let turn = turns(x, y) * self.columns - T::of(0.5);
        let sector = turn.whole();
        let s = self.shape(turn - sector);
        let last = self.columns - T::ONE;
        let column = if sector < T::ZERO { last } else { sector };
        [row, column, if column == last { -last } else { T::ONE }, t, s]
    }

    #[inline(always)]
    fn concentric(&self, [x, y, z]: [T; 3]) -> [T; 5] {
        let scale = T::ONE / (T::ONE + z.clamped()).root();
        let (x, y) = (x * scale, y * scale);
        let radius = (x * x + y * y).root();
        let (a, b) = (x.magnitude(), y.magnitude());
        let longer = a.most(b);
        let ratio = a.least(b) / longer.most(T::of(1e-30));
        let side = radius * ratio.short_arctangent() * T::of(4.0 * FRAC_1_PI);
        let (u, v) = (if a >= b { radius } else { side }, if a >= b { side } else { radius });
        let (u, v) = (if x < T::ZERO { -u } else { u }, if y < T::ZERO { -v } else { v });
        let cell = |of: T, count: T| self.between((of + T::ONE) * (T::of(0.5) * count) - T::of(0.5), count);
        let ((row, t), (column, s)) = (cell(v, self.rows), cell(u, self.columns));
        [row, column, T::ONE, t, s]
    }
}

/// atan2 in turns, in [0, 1].
#[inline(always)]
fn turns<T: Real>(x: T, y: T) -> T {
    let (a, b) = (x.magnitude(), y.magnitude());
    let octant = (a.least(b) / a.most(b).most(T::of(1e-30))).short_arctangent() * T::of(0.5 * FRAC_1_PI);
    let quadrant = if a < b { T::of(0.25) - octant } else { octant };
    let half_plane = if x < T::ZERO { T::of(0.5) - quadrant } else { quadrant };
    if y < T::ZERO { T::ONE - half_plane } else { half_plane }
}

/// The taps of N directions.
pub struct Taps<T, const N: usize> {
    first: [i32; N],
    /// From the first to the tap in the next column.
    next: [i32; N],
    /// Weights of the second row and of the second column.
    t: [T; N],
    s: [T; N],
}

impl<T: Real, const N: usize> Taps<T, N> {
    pub const NONE: Self = Self { first: [0; N], next: [0; N], t: [T::ZERO; N], s: [T::ZERO; N] };

    /// `directions`: unit, in the frames of the triangles.
    #[inline(always)]
    pub fn set(&mut self, layout: &Layout<T>, directions: impl Fn(usize) -> [T; 3]) {
        match layout.concentric {
            true => self.fill(layout, |k| layout.concentric(directions(k))),
            false => self.fill(layout, |k| layout.equal_angle(directions(k))),
        }
    }

    #[inline(always)]
    fn fill(&mut self, layout: &Layout<T>, cells: impl Fn(usize) -> [T; 5]) {
        for k in 0..N {
            let [row, column, next, t, s] = cells(k);
            self.first[k] = (row * layout.columns + column).index();
            self.next[k] = next.index();
            self.t[k] = t;
            self.s[k] = s;
        }
    }

    #[inline(always)]
    fn of(&self, k: usize, layout: &Layout<T>) -> [(usize, T); 4] {
        let (first, next) = (self.first[k] as usize, (self.first[k] + self.next[k]) as usize);
        let (t, s) = (self.t[k], self.s[k]);
        let (u, v) = (T::ONE - t, T::ONE - s);
        [(first, u * v), (next, u * s), (first + layout.stride, t * v), (next + layout.stride, t * s)]
    }

    /// Σ_b T_b values\[b\], RGB, of the values of a triangle as they are in memory.
    #[inline(always)]
    pub fn gather(&self, k: usize, layout: &Layout<T>, values: &[T]) -> [T; 4] {
        let mut sum = [T::ZERO; 4];
        for (bin, weight) in self.of(k, layout) {
            let value = match layout.channels {
                1 => [values[bin]; 4],
                _ => {
                    let value = &values[3 * bin..3 * bin + 3];
                    [value[0], value[1], value[2], T::ZERO]
                }
            };
            add(&mut sum, weight, value);
        }
        sum
    }

    /// bins\[b\] += T_b value.
    #[inline(always)]
    pub fn deposit(&self, k: usize, layout: &Layout<T>, bins: &mut [[T; 4]], value: [T; 4]) {
        for (bin, weight) in self.of(k, layout) {
            add(&mut bins[bin], weight, value);
        }
    }
}

/// sum += weight value.
#[inline(always)]
pub fn add<T: Real>(sum: &mut [T; 4], weight: T, value: [T; 4]) {
    for (sum, value) in sum.iter_mut().zip(value) {
        *sum += weight * value;
    }
}

/// Adds to the bins of a triangle in memory, each times its factor, and clears them.
pub fn flush<T: Real>(layout: &Layout<T>, bins: &mut [[T; 4]], factor: impl Fn(usize) -> T, to: &mut [T]) {
    for (bin, (sum, to)) in bins.iter_mut().zip(to.chunks_exact_mut(layout.channels)).enumerate() {
        let factor = factor(bin);
        to.iter_mut().zip(&*sum).for_each(|(to, &sum)| *to += factor * sum);
        *sum = [T::ZERO; 4];
    }
}
