//! Direction bins of several directions at a time: the four bilinear weights T_b(ω) of each and the bins that
//! they belong to. Twin of crates/core/glsl/bins.glsl.

use super::real::Real;
use crate::plan::Plan;
use antirad_scene::BinLayout;
use std::f64::consts::{FRAC_1_PI, FRAC_2_PI};

/// A partition of the hemisphere.
#[derive(Clone, Copy)]
pub struct Layout<T> {
    concentric: bool,
    rows: T,
    columns: T,
    /// Channels of a bin in memory: 3, or 1 for a scene without colour.
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
            rows: T::of(rows.into()),
            columns: T::of(columns.into()),
            channels: plan.channels as usize,
            count: plan.bins.count(),
            stride: columns as usize,
        }
    }

    /// The value of a bin, of those of a triangle as they are in memory.
    #[inline(always)]
    fn rgb(&self, values: &[T], bin: usize) -> [T; 4] {
        match self.channels {
            1 => [values[bin]; 4],
            _ => {
                let value = &values[3 * bin..3 * bin + 3];
                [value[0], value[1], value[2], T::ZERO]
            }
        }
    }

    /// The first of the two cells around a coordinate, whose centres are 0, 1, … count - 1, and the weight of the second.
    #[inline(always)]
    fn between(&self, coordinate: T, count: T) -> (T, T) {
        let coordinate = coordinate.most(T::ZERO).least(count - T::ONE);
        let first = coordinate.whole().least(count - T::of(2.0));
        (first, coordinate - first)
    }

    /// Row and column of the first of the four bins, the step from there to the next column, and the weights
    /// of the second row and column. `w`: unit, in the frame of the triangle; directions below the horizon
    /// count as on it.
    #[inline(always)]
    fn equal_angle(&self, [x, y, z]: [T; 3]) -> [T; 5] {
        let polar = z.clamped().arccosine() * T::of(FRAC_2_PI);
        let (row, t) = self.between(polar * self.rows - T::of(0.5), self.rows);
        let level = x * x + y * y > T::POLE * T::POLE;
        let (x, y) = (if level { x } else { T::ZERO }, if level { y } else { T::ZERO });
        let turn = turns(x, y) * self.columns - T::of(0.5);
        let sector = turn.whole();
        let s = turn - sector;
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

    /// The slope of the weight of the second of the two cells [`between`](Self::between).
    #[inline(always)]
    fn between_slope(&self, coordinate: T, count: T) -> T {
        let inside = (coordinate > T::ZERO) & (coordinate < count - T::ONE);
        if inside { T::ONE } else { T::ZERO }
    }

    /// The gradient by the direction, from the derivatives along rows and columns. It is zero where it is
    /// undefined: at the pole, and along the polar angle below the horizon.
    #[inline(always)]
    fn equal_angle_gradient(&self, [x, y, z]: [T; 3], [by_row, by_column]: [T; 2]) -> [T; 3] {
        let above = z > T::ZERO;
        let z = z.most(T::ZERO);
        let r2 = x * x + y * y;
        let r = r2.root();
        let per_r = if r > T::POLE { T::ONE / r } else { T::ZERO };
        let rows = T::of(FRAC_2_PI) * self.rows;
        let polar = z.least(T::ONE).arccosine();
        let row = by_row * self.between_slope(polar * rows - T::of(0.5), self.rows) * rows / (r2 + z * z);
        let row = if above { row } else { T::ZERO };
        let column = by_column * T::of(0.5 * FRAC_1_PI) * self.columns * per_r;
        let (u, v) = (x * per_r, y * per_r);
        [row * z * u - column * v, row * z * v + column * u, -row * r]
    }

    #[inline(always)]
    fn concentric_gradient(&self, [x, y, z]: [T; 3], [by_row, by_column]: [T; 2]) -> [T; 3] {
        let above = z > T::ZERO;
        let z = z.most(T::ZERO);
        let scale = T::ONE / (T::ONE + z).root();
        let (x, y) = (x * scale, y * scale);
        let radius = (x * x + y * y).root();
        let (a, b) = (x.magnitude(), y.magnitude());
        let wide = a >= b;
        let pole = radius <= T::POLE;
        let angle = (a.least(b) / a.most(b).most(T::of(1e-30))).short_arctangent();
        let angle = if pole { T::ZERO } else { angle };
        let side = radius * angle * T::of(4.0 * FRAC_1_PI);
        let one = T::ONE;
        let [sign_x, sign_y] = [if x < T::ZERO { -one } else { one }, if y < T::ZERO { -one } else { one }];
        let half = T::of(0.5) * self.rows;
        let cell = |of: T| (of + T::ONE) * half - T::of(0.5);
        let [column, row] = [
            cell(sign_x * if wide { radius } else { side }),
            cell(sign_y * if wide { side } else { radius }),
        ];
        let per_radius = if pole { T::ZERO } else { T::ONE / radius };
        let along = [x * per_radius, y * per_radius];
        // Across the radius, by the angle from the nearer axis.
        let turn = if wide { per_radius } else { -per_radius };
        let across = [-turn * b * sign_x, turn * a * sign_y];
        let of_side = |k: usize| T::of(4.0 * FRAC_1_PI) * (angle * along[k] + across[k]);
        let of_side = [of_side(0), of_side(1)];
        let row = by_row * self.between_slope(row, self.rows) * half * sign_y;
        let column = by_column * self.between_slope(column, self.rows) * half * sign_x;
        let gradient = |k: usize| {
            let (long, short) = (along[k], of_side[k]);
            row * if wide { short } else { long } + column * if wide { long } else { short }
        };
        let (u, v) = (gradient(0), gradient(1));
        let by_z = -T::of(0.5) * (u * x + v * y) / (T::ONE + z);
        [u * scale, v * scale, if above { by_z } else { T::ZERO }]
    }

    /// The gradients of Σ_tap weight · value by N directions, in the frames of triangles, from the slopes along rows and columns.
    #[inline(always)]
    pub fn gradients<const N: usize>(
        &self,
        directions: &[[T; N]; 3],
        slopes: &[[T; N]; 2],
        to: &mut [[T; N]; 3],
    ) {
        // Loops without branches.
        match self.concentric {
            true => self.gradients_of::<true, N>(directions, slopes, to),
            false => self.gradients_of::<false, N>(directions, slopes, to),
        }
    }

    #[inline(always)]
    fn gradients_of<const CONCENTRIC: bool, const N: usize>(
        &self,
        directions: &[[T; N]; 3],
        slopes: &[[T; N]; 2],
        to: &mut [[T; N]; 3],
    ) {
        for k in 0..N {
            let (w, by) =
                ([directions[0][k], directions[1][k], directions[2][k]], [slopes[0][k], slopes[1][k]]);
            let by = match CONCENTRIC {
                true => self.concentric_gradient(w, by),
                false => self.equal_angle_gradient(w, by),
            };
            (to[0][k], to[1][k], to[2][k]) = (by[0], by[1], by[2]);
        }
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

/// The bilinear weights of N directions.
pub struct Taps<T, const N: usize> {
    first: [i32; N],
    /// Step from the first bin to that in the next column.
    next: [i32; N],
    /// Weights of the second row and of the second column.
    t: [T; N],
    s: [T; N],
}

impl<T: Real, const N: usize> Taps<T, N> {
    pub const NONE: Self = Self { first: [0; N], next: [0; N], t: [T::ZERO; N], s: [T::ZERO; N] };

    /// `directions`: unit, in the frames of the triangles. Both loops call it: mark it as inlined, or it may not be, and then neither
    /// becomes vectors (see [`vectorised`](antirad_gpu::vectorised)).
    #[inline(always)]
    pub fn set(&mut self, layout: &Layout<T>, directions: impl Fn(usize) -> [T; 3]) {
        match layout.concentric {
            true => self.fill(
                layout,
                #[inline(always)]
                |k| layout.concentric(directions(k)),
            ),
            false => self.fill(
                layout,
                #[inline(always)]
                |k| layout.equal_angle(directions(k)),
            ),
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

    /// The bilinear weights of a direction.
    #[inline(always)]
    pub fn tap(&self, k: usize) -> Tap<T> {
        Tap { first: self.first[k] as u16, next: self.next[k] as i16, t: self.t[k], s: self.s[k] }
    }

    /// Σ_b T_b values\[b\], RGB, of the values of a triangle as they are in memory.
    #[inline(always)]
    pub fn gather(&self, k: usize, layout: &Layout<T>, values: &[T]) -> [T; 4] {
        self.tap(k).gather(layout, values)
    }

    /// The four terms of Σ_b T_b values\[b\]: weights, and RGB values.
    #[inline(always)]
    pub fn terms(&self, k: usize, layout: &Layout<T>, values: &[T]) -> [(T, [T; 4]); 4] {
        let [a, b, c, d] = self.tap(k).of(layout);
        let term = |(bin, weight)| (weight, layout.rgb(values, bin));
        [term(a), term(b), term(c), term(d)]
    }

    /// The derivatives along rows and columns of Σ_b T_b value.
    #[inline(always)]
    pub fn slopes(&self, k: usize, [a, b, c, d]: [T; 4]) -> [T; 2] {
        let (t, s) = (self.t[k], self.s[k]);
        [(T::ONE - s) * (c - a) + s * (d - b), (T::ONE - t) * (b - a) + t * (d - c)]
    }

    /// Scatters a value to the four bins: bins\[b\] += T_b value.
    #[inline(always)]
    pub fn scatter(&self, k: usize, layout: &Layout<T>, bins: &mut [[T; 4]], value: [T; 4]) {
        self.tap(k).scatter(layout, bins, value);
    }
}

/// The bilinear weights of a direction. A plan has no more bins than 16 bits count.
#[derive(Clone, Copy)]
pub struct Tap<T> {
    first: u16,
    next: i16,
    t: T,
    s: T,
}

impl<T: Real> Tap<T> {
    #[inline(always)]
    fn of(&self, layout: &Layout<T>) -> [(usize, T); 4] {
        let Self { t, s, .. } = *self;
        let first = self.first as usize;
        let next = first.wrapping_add_signed(self.next.into());
        let (u, v) = (T::ONE - t, T::ONE - s);
        [(first, u * v), (next, u * s), (first + layout.stride, t * v), (next + layout.stride, t * s)]
    }

    /// Σ_b T_b values\[b\], RGB, of the values of a triangle as they are in memory.
    #[inline(always)]
    pub fn gather(&self, layout: &Layout<T>, values: &[T]) -> [T; 4] {
        let mut sum = [T::ZERO; 4];
        for (bin, weight) in self.of(layout) {
            add(&mut sum, weight, layout.rgb(values, bin));
        }
        sum
    }

    /// Scatters a value to the four bins: bins\[b\] += T_b value.
    #[inline(always)]
    pub fn scatter(&self, layout: &Layout<T>, bins: &mut [[T; 4]], value: [T; 4]) {
        for (bin, weight) in self.of(layout) {
            add(&mut bins[bin], weight, value);
        }
    }
}

#[inline(always)]
pub fn scaled<T: Real>(factor: T, [r, g, b, rest]: [T; 4]) -> [T; 4] {
    [factor * r, factor * g, factor * b, factor * rest]
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
