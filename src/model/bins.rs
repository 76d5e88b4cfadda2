//! Direction bins: interpolation weights T_b(ω) and the integrals w_b, c_b of that basis over the hemisphere.

use crate::scene::BinLayout;
use glam::{DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::{Mutex, PoisonError};

/// Midpoint samples per bin and axis of the quadrature, for a relative error of c_b below 1e-6.
const QUADRATURE: u32 = 64;

/// Sines below this are rounding, where there is no azimuth.
const POLE: f64 = 1e-12;

/// The four bins around a direction and their weights, which sum to 1.
pub type Taps = [(usize, f64); 4];

/// Two neighbouring cells of one coordinate of a layout, and where between their centres a direction lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cells {
    pub first: usize,
    pub next: usize,
    /// 0 at the centre of `first`, 1 at that of `next`: the weight of the latter.
    pub fraction: f64,
    /// Outside the outermost centres, where the weights do not depend on the coordinate.
    pub clamped: bool,
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
    pub(crate) fn half_cosine(&self, b: usize, o: usize) -> f64 {
        (self.centre[b] + self.centre[o]).normalize_or_zero().z.max(0.0)
    }

    /// T_b(ω): the four taps of a direction of the upper hemisphere. Defined everywhere: at the pole, on the horizon
    /// (directions below it count as on it).
    pub fn taps(&self, direction: DVec3) -> Taps {
        self.taps_beside(POLE, direction)
    }

    /// The same where rounding hides the azimuth of sines up to `pole`, and must not choose one: as the kernels have it.
    pub(crate) fn taps_beside(&self, pole: f64, direction: DVec3) -> Taps {
        let (row, column) = self.cells_beside(pole, direction);
        product(row.fraction, column.fraction, self.around(row, column))
    }

    /// Where a direction lies in the two coordinates of the layout: polar angle and azimuth, or v and u of the square.
    pub(crate) fn cells(&self, direction: DVec3) -> (Cells, Cells) {
        self.cells_beside(POLE, direction)
    }

    fn cells_beside(&self, pole: f64, direction: DVec3) -> (Cells, Cells) {
        match self.layout {
            BinLayout::EqualAngle { theta, phi } => {
                let polar = direction.truncate().length().atan2(direction.z.max(0.0));
                let row = clamped(polar * f64::from(theta) / FRAC_PI_2 - 0.5, theta);
                let level = direction.truncate();
                let level = if level.length() > pole { level } else { DVec2::ZERO };
                let azimuth = level.y.atan2(level.x) / TAU;
                let turn = (azimuth - azimuth.floor()) * f64::from(phi) - 0.5;
                let sector = turn.floor();
                let fraction = turn - sector;
                let phi = phi as usize;
                let first = (sector as i64).rem_euclid(phi as i64) as usize;
                (row, Cells { first, next: (first + 1) % phi, fraction, clamped: false })
            }
            BinLayout::Concentric { n } => {
                let square = concentric_square(direction);
                let cell = |x: f64| clamped((x + 1.0) * 0.5 * f64::from(n) - 0.5, n);
                (cell(square.1), cell(square.0))
            }
        }
    }

    /// The bins of the four taps, in the order of [`Bins::taps`].
    pub(crate) fn around(&self, row: Cells, column: Cells) -> [usize; 4] {
        let columns = match self.layout {
            BinLayout::EqualAngle { phi, .. } => phi as usize,
            BinLayout::Concentric { n } => n as usize,
        };
        let at = |row: usize, column: usize| row * columns + column;
        [
            at(row.first, column.first),
            at(row.first, column.next),
            at(row.next, column.first),
            at(row.next, column.next),
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

/// The two cells around a coordinate whose centres are 0, 1, … n-1.
fn clamped(coordinate: f64, n: u32) -> Cells {
    let last = f64::from(n - 1);
    let inside = coordinate.clamp(0.0, last);
    let first = inside.floor().min(last - 1.0);
    Cells {
        first: first as usize,
        next: first as usize + 1,
        fraction: inside - first,
        clamped: !(0.0 < coordinate && coordinate < last),
    }
}

fn product(t: f64, s: f64, index: [usize; 4]) -> Taps {
    let weight = [(1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s];
    std::array::from_fn(|k| (index[k], weight[k]))
}

fn spherical(polar: f64, azimuth: f64) -> DVec3 {
    DVec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos())
}

/// The point of [-1, 1]² that Shirley and Chiu's equal-area concentric map (1997) sends to a direction. The disk point
/// (x, y)/√(1+z) has radius √(1-z) without the cancellation of that form at the pole.
fn concentric_square(direction: DVec3) -> (f64, f64) {
    let disk = direction.truncate() / (1.0 + direction.z.max(0.0)).sqrt();
    let radius = disk.length();
    let (x, y) = (disk.x.abs(), disk.y.abs());
    let (long, short) = (x.max(y), x.min(y));
    let side = if long > 0.0 { radius * (short / long).atan() / (PI / 4.0) } else { 0.0 };
    let (u, v) = if x >= y { (radius, side) } else { (side, radius) };
    (u.copysign(disk.x), v.copysign(disk.y))
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
            let (u, v) = concentric_square(direction);
            assert!((concentric_direction(u, v) - direction).length() <= 1e-7, "{direction}");
        }
    }
}
