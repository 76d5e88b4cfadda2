//! Direction bins: interpolation weights T_b(ω) and the integrals w_b, c_b of that basis over the hemisphere.

use super::scalar::Scalar;
use super::vector::Vector;
use antirad_scene::BinLayout;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::{Mutex, PoisonError};

/// Midpoint samples per bin and axis of the quadrature, for a relative error of c_b below 1e-6.
const QUADRATURE: u32 = 64;

/// Sines below this are rounding, where there is no azimuth, and no derivative.
const POLE: f64 = 1e-12;

/// The four bins around a direction and their weights, which sum to 1.
pub type Taps<S = f64> = [(usize, S); 4];

/// Two neighbouring cells of one coordinate of a layout, and where between their centres a direction lies.
struct Cells<S> {
    first: usize,
    next: usize,
    /// 0 at the centre of `first`, 1 at that of `next`; the weight of the latter.
    fraction: S,
}

/// A hemisphere split into bins. Directions are unit vectors in the frame of the triangle, z along the normal.
#[derive(Clone, Debug)]
pub struct Bins {
    /// Partition of the hemisphere.
    pub layout: BinLayout,
    /// w_b = ∫ T_b dω, sr; sums to 2π.
    pub solid_angle: Vec<f64>,
    /// c_b = ∫ T_b cosθ dω, sr; sums to π.
    pub projected: Vec<f64>,
    /// The direction at which T_b = 1.
    pub centre: Vec<DVec3>,
}

/// All bins that this process has computed: their quadrature takes as long as planning a small scene.
static MADE: Mutex<Vec<Bins>> = Mutex::new(Vec::new());

impl Bins {
    /// Computes the integrals by quadrature of T_b.
    pub fn new(layout: BinLayout) -> Self {
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        let known = made.iter().find(|bins| bins.layout == layout);
        known.cloned().unwrap_or_else(|| {
            made.push(Self::integrated(layout));
            made[made.len() - 1].clone()
        })
    }

    fn integrated(layout: BinLayout) -> Self {
        let count = layout.count();
        let mut bins = Self {
            layout,
            solid_angle: vec![0.0; count],
            projected: vec![0.0; count],
            centre: (0..count).map(|b| centre(layout, b)).collect(),
        };
        bins.integrate();
        bins
    }

    /// Number of bins B.
    pub fn count(&self) -> usize {
        self.centre.len()
    }

    /// ⟨h(b,o),n⟩, the cosine between the normal and the half vector of two bins, clamped to [0, 1].
    pub fn half_cosine(&self, b: usize, o: usize) -> f64 {
        (self.centre[b] + self.centre[o]).normalize_or_zero().z.max(0.0)
    }

    /// T_b(ω): the four bins around a direction of the upper hemisphere, with their bilinear weights. Defined
    /// everywhere: at the pole, and on the horizon (directions below it count as on it).
    pub fn taps<V: Vector>(&self, direction: V) -> Taps<V::Scalar> {
        self.taps_beside(POLE, direction)
    }

    /// Bilinear weights as [`Self::taps`] returns them, but in the equal-angle layout directions whose
    /// horizontal length is at most `pole` count as the pole: rounding hides their azimuth and must not
    /// choose one. Kernels do the same.
    pub(crate) fn taps_beside<V: Vector>(&self, pole: f64, direction: V) -> Taps<V::Scalar> {
        let (row, column, columns) = match self.layout {
            BinLayout::EqualAngle { theta, phi } => {
                let [polar, azimuth] = angles(pole, direction);
                let row = between(polar * f64::from(theta) / FRAC_PI_2 - 0.5, theta);
                (row, around(azimuth / TAU, phi), phi)
            }
            BinLayout::Concentric { n } => {
                let cell = |x: V::Scalar| between((x + 1.0) * 0.5 * f64::from(n) - 0.5, n);
                let [u, v] = concentric_square(direction);
                (cell(v), cell(u), n)
            }
        };
        let (t, s) = (row.fraction, column.fraction);
        let [not_t, not_s] = [t, s].map(|weight| -weight + 1.0);
        let at = |row: usize, column: usize| row * columns as usize + column;
        [
            (at(row.first, column.first), not_t * not_s),
            (at(row.first, column.next), not_t * s),
            (at(row.next, column.first), t * not_s),
            (at(row.next, column.next), t * s),
        ]
    }

    /// Computes w_b and c_b by midpoint quadrature over cells of the layout's own map, then scales them to the exact
    /// sums.
    fn integrate(&mut self) {
        let count = self.count();
        let (mut w, mut c) = (vec![0.0; count], vec![0.0; count]);
        let mut add = |direction: DVec3, solid_angle: f64| {
            for (b, weight) in self.taps(direction) {
                w[b] += weight * solid_angle;
                c[b] += weight * solid_angle * direction.z;
            }
        };
        match self.layout {
            BinLayout::EqualAngle { theta, phi } => {
                let (rows, turns) = (theta * QUADRATURE, phi * QUADRATURE);
                for row in 0..rows {
                    let edge = |k: u32| (f64::from(k) / f64::from(rows) * FRAC_PI_2).cos();
                    let area = (edge(row) - edge(row + 1)) * TAU / f64::from(turns);
                    let polar = (f64::from(row) + 0.5) / f64::from(rows) * FRAC_PI_2;
                    for turn in 0..turns {
                        let azimuth = (f64::from(turn) + 0.5) / f64::from(turns) * TAU;
                        add(spherical(polar, azimuth), area);
                    }
                }
            }
            BinLayout::Concentric { n } => {
                let cells = n * QUADRATURE;
                let at = |k: u32| (f64::from(k) + 0.5) / f64::from(cells) * 2.0 - 1.0;
                let area = TAU / f64::from(cells).powi(2);
                for v in 0..cells {
                    for u in 0..cells {
                        add(concentric_direction(at(u), at(v)), area);
                    }
                }
            }
        }
        let (sum_w, sum_c) = (w.iter().sum::<f64>(), c.iter().sum::<f64>());
        self.solid_angle = w.iter().map(|x| x * TAU / sum_w).collect();
        self.projected = c.iter().map(|x| x * PI / sum_c).collect();
    }
}

/// The two cells around a coordinate whose centres are 0, 1, … n-1. Outside the outermost, the coordinate does not matter.
fn between<S: Scalar>(coordinate: S, n: u32) -> Cells<S> {
    let last = f64::from(n - 1);
    let inside = coordinate.clamp(0.0, last);
    let first = inside.value().floor().min(last - 1.0);
    Cells { first: first as usize, next: first as usize + 1, fraction: inside - first }
}

/// The two of n cells around an azimuth in turns, the last beside the first.
fn around<S: Scalar>(azimuth: S, n: u32) -> Cells<S> {
    let turn = (azimuth - azimuth.value().floor()) * f64::from(n) - 0.5;
    let sector = turn.value().floor();
    let first = (sector as i64).rem_euclid(i64::from(n)) as usize;
    Cells { first, next: (first + 1) % n as usize, fraction: turn - sector }
}

/// The two coordinates in the plane of the triangle, constant up to a length.
fn level<S: Scalar>(pole: f64, [x, y]: [S; 2]) -> [S; 2] {
    if x.value().hypot(y.value()) > pole { [x, y] } else { [0.0.into(); 2] }
}

/// Polar angle and azimuth.
fn angles<V: Vector>(pole: f64, direction: V) -> [V::Scalar; 2] {
    let [x, y, z] = direction.to_array();
    let [x, y] = level(pole, [x, y]);
    [(x * x + y * y).sqrt().atan2(z.max(0.0)), y.atan2(x)]
}

fn spherical(polar: f64, azimuth: f64) -> DVec3 {
    DVec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos())
}

/// The point of [-1, 1]² that Shirley and Chiu's equal-area concentric map (1997) sends to a direction. The disk point
/// (x, y)/√(1+z) has radius √(1-z) without the cancellation of that form at the pole.
fn concentric_square<V: Vector>(direction: V) -> [V::Scalar; 2] {
    let [x, y, z] = direction.to_array();
    let scale = (z.max(0.0) + 1.0).sqrt();
    let [x, y] = level(POLE, [x / scale, y / scale]);
    let radius = (x * x + y * y).sqrt();
    if radius == 0.0 {
        return [radius; 2];
    }
    let along_x = x.value().abs() >= y.value().abs();
    let (long, short) = if along_x { (x.abs(), y.abs()) } else { (y.abs(), x.abs()) };
    let side = radius * (short / long).atan() / (PI / 4.0);
    let (u, v) = if along_x { (radius, side) } else { (side, radius) };
    let signed = |size: V::Scalar, of: V::Scalar| if of < 0.0 { -size } else { size };
    [signed(u, x), signed(v, y)]
}

fn concentric_direction(u: f64, v: f64) -> DVec3 {
    let (long, short) = (u.abs().max(v.abs()), u.abs().min(v.abs()));
    let angle = if long > 0.0 { short / long * PI / 4.0 } else { 0.0 };
    let (x, y) = if u.abs() >= v.abs() { (angle.cos(), angle.sin()) } else { (angle.sin(), angle.cos()) };
    let z = 1.0 - long * long;
    let sine = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new((x * sine).copysign(u), (y * sine).copysign(v), z)
}

fn centre(layout: BinLayout, bin: usize) -> DVec3 {
    let half = |k: usize, n: u32| (k as f64 + 0.5) / f64::from(n);
    match layout {
        BinLayout::EqualAngle { theta, phi } => {
            let (row, sector) = (bin / phi as usize, bin % phi as usize);
            spherical(half(row, theta) * FRAC_PI_2, half(sector, phi) * TAU)
        }
        BinLayout::Concentric { n } => {
            let (v, u) = (bin / n as usize, bin % n as usize);
            concentric_direction(half(u, n) * 2.0 - 1.0, half(v, n) * 2.0 - 1.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Dual, DualVector};
    use glam::DVec2;

    const LAYOUTS: [BinLayout; 4] = [
        BinLayout::EqualAngle { theta: 10, phi: 13 },
        BinLayout::EqualAngle { theta: 2, phi: 3 },
        BinLayout::Concentric { n: 2 },
        BinLayout::Concentric { n: 12 },
    ];

    fn every_kind() -> impl Iterator<Item = Bins> {
        LAYOUTS.into_iter().map(Bins::new)
    }

    /// Directions all over the hemisphere, the pole and the horizon among them.
    fn directions() -> Vec<DVec3> {
        let mut all = vec![DVec3::Z, DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y, DVec3::new(1e-12, 0.0, 1.0)];
        for k in 0..2000 {
            let z = (k as f64 + 0.5) / 2000.0;
            all.push(spherical(z.acos(), k as f64 * 2.399_963));
        }
        all
    }

    #[test]
    fn weights_are_a_partition_of_unity_everywhere() {
        for bins in every_kind() {
            for direction in directions() {
                let taps = bins.taps(direction);
                let sum: f64 = taps.iter().map(|t| t.1).sum();
                assert!((sum - 1.0).abs() <= 1e-14, "{:?} {direction}: {sum}", bins.layout);
                assert!(taps.iter().all(|&(b, w)| b < bins.count() && (0.0..=1.0).contains(&w)));
            }
        }
    }

    #[test]
    fn bins_of_a_layout_are_made_once() {
        let layout = BinLayout::EqualAngle { theta: 3, phi: 7 };
        let all = [0; 3].map(|_| Bins::new(layout).projected);
        assert!(all.iter().all(|projected| *projected == Bins::integrated(layout).projected));
        let made = MADE.lock().expect("no test panics with it");
        assert_eq!(made.iter().filter(|bins| bins.layout == layout).count(), 1);
    }

    #[test]
    fn integrals_sum_to_the_hemisphere_and_are_positive() {
        for bins in every_kind() {
            assert!((bins.solid_angle.iter().sum::<f64>() - TAU).abs() <= 1e-12);
            assert!((bins.projected.iter().sum::<f64>() - PI).abs() <= 1e-12);
            assert!(bins.projected.iter().chain(&bins.solid_angle).all(|&x| x > 1e-4));
        }
    }

    #[test]
    fn a_bin_has_weight_one_at_its_centre() {
        for bins in every_kind() {
            for (b, &centre) in bins.centre.iter().enumerate() {
                let at: f64 = bins.taps(centre).iter().filter(|t| t.0 == b).map(|t| t.1).sum();
                assert!((at - 1.0).abs() <= 1e-9, "{:?} bin {b}: {at}", bins.layout);
            }
        }
    }

    #[test]
    fn concentric_map_and_its_inverse_agree() {
        for direction in directions() {
            let [u, v] = concentric_square(direction);
            assert!((concentric_direction(u, v) - direction).length() <= 1e-7, "{direction}");
        }
    }

    /// A sum over the bilinear weights of a direction, and its gradient by the direction.
    fn read(bins: &Bins, direction: DVec3) -> (f64, DVec3) {
        let value_of = |bin: usize| (bin as f64 * 1.7).sin();
        let taps = bins.taps(DualVector::<3>::variable(direction, 0));
        assert_eq!(taps.map(|(bin, weight)| (bin, weight.value)), bins.taps(direction));
        let sum = taps.iter().fold(Dual::from(0.0), |sum, &(bin, weight)| sum + weight * value_of(bin));
        (sum.value, sum.slopes.into())
    }

    /// Along two tangents, by central differences with step 1e-6, whose error is 1e-9. Where a kink lies within the step, half the
    /// step gives another slope, and the direction is skipped; few are.
    #[test]
    fn taps_match_their_slopes() {
        for bins in every_kind() {
            let (mut compared, mut kinks) = (0, 0);
            for k in 0..2000 {
                let (z, azimuth) = (-0.1 + 1.1 * (k as f64 + 0.5) / 2000.0, k as f64 * 2.399_963);
                let d = (DVec2::from_angle(azimuth) * (1.0_f64 - z * z).sqrt()).extend(z);
                let (_, gradient) = read(&bins, d);
                let (one, other) = d.any_orthonormal_pair();
                for tangent in [one, other] {
                    let slope = |step: f64| {
                        let at = |step: f64| read(&bins, (d + step * tangent).normalize()).0;
                        (at(step) - at(-step)) / (2.0 * step)
                    };
                    let (slope, half) = (slope(1e-6), slope(5e-7));
                    if (slope - half).abs() > 1e-8 * slope.abs().max(1.0) {
                        kinks += 1;
                        continue;
                    }
                    compared += 1;
                    let error = gradient.dot(tangent) - slope;
                    assert!(
                        error.abs() <= 1e-8 * slope.abs().max(1.0),
                        "{:?} {d}: {slope} {error:e}",
                        bins.layout
                    );
                }
            }
            assert!(kinks * 100 <= compared, "{kinks} kinks, {compared} compared");
        }
    }

    #[test]
    fn slopes_are_finite_everywhere() {
        let tiny = [0.0, 1e-320, 1e-160, 1e-15, 1e-9];
        for bins in every_kind() {
            for (x, y) in tiny.into_iter().flat_map(|x| tiny.map(|y| (x, -y))) {
                for z in [1.0, 0.0, -0.0, -1.0, 1e-300] {
                    for d in [DVec3::new(x, y, z), DVec3::new(z, x, y), DVec3::new(x, z, y)] {
                        assert!(read(&bins, d).1.is_finite(), "{:?} {d}", bins.layout);
                    }
                }
            }
        }
    }
}
