//! Which triangles to cut for a smaller error.

use antirad_scene::Scene;
use glam::DVec3;

/// What a cut into four is expected to leave of the square of a triangle's error: of smooth light it would be a sixteenth.
const AFTER_A_CUT: f64 = 1.0 / 12.0;

/// Share of the allowed error that is left after cutting, if the estimate is right.
const CLEAR: f64 = 0.85;

/// Most cuts of a triangle at once: an estimate says little about smaller parts.
const AT_ONCE: u32 = 2;

/// A mesh of a scene.
#[derive(Clone)]
pub(super) struct Mesh {
    pub scene: Scene,
    /// Per triangle of `scene`, the index of the given triangle that it is a part of.
    pub parents: Vec<u32>,
}

impl Mesh {
    /// Cuts each triangle into four so many times, and with it the other side of its sheet.
    pub fn cut(&mut self, times: &[u32]) {
        let mut parts: Vec<u32> = (0..self.parents.len() as u32).collect();
        for round in 0..times.iter().copied().max().unwrap_or(0) {
            let other_sides = self.scene.other_sides();
            let is_asked = |t: u32| times[parts[t as usize] as usize] > round;
            let chosen: Vec<u32> = (0..parts.len() as u32)
                .filter(|&t| is_asked(t) || other_sides[t as usize].is_some_and(is_asked))
                .collect();
            parts = self.scene.split(&chosen).into_iter().map(|part| parts[part as usize]).collect();
        }
        self.compose(&parts);
    }

    /// `parts`: per new triangle, the former one that it is a part of.
    fn compose(&mut self, parts: &[u32]) {
        self.parents = parts.iter().map(|&part| self.parents[part as usize]).collect();
    }
}

/// A relative L2 error that is due to the size of triangles.
#[derive(Clone, Debug)]
pub(super) struct MeshError {
    /// Per triangle, its share of the square of the error.
    squares: Vec<f64>,
}

impl MeshError {
    /// The error `of` each triangle, with its weight, relative to `all`. None where there is no light.
    pub fn new(weights: &[f64], of: &dyn Fn(usize) -> DVec3, all: f64) -> Self {
        let over = if all > 0.0 { all.powi(-2) } else { 0.0 };
        let square = |(i, weight): (usize, &f64)| over * weight * of(i).length_squared();
        Self { squares: weights.iter().enumerate().map(square).collect() }
    }

    pub fn total(&self) -> f64 {
        self.squares.iter().sum::<f64>().sqrt()
    }
}

/// How often to cut each triangle so that errors get from above `allowed` to less, the worst triangles first, or as far as
/// `room` for more triangles goes; and the number of triangles that this adds, whether there is room or not.
pub(super) fn cuts(errors: &[MeshError], allowed: f64, room: usize) -> (Vec<u32>, usize) {
    let mut all = vec![0; errors.first().map_or(0, |error| error.squares.len())];
    let mut more = 0;
    for error in errors.iter().filter(|error| error.total() > allowed) {
        let most = error.squares.iter().copied().fold(0.0, f64::max);
        let mut limit = most;
        loop {
            limit *= 0.5;
            let of = |square: f64| {
                let times = (square / limit).log(1.0 / AFTER_A_CUT).ceil();
                times.clamp(0.0, f64::from(AT_ONCE)) as u32
            };
            let left: f64 =
                error.squares.iter().map(|&square| square * AFTER_A_CUT.powi(of(square) as i32)).sum();
            let next: Vec<u32> =
                all.iter().zip(&error.squares).map(|(&cuts, &square)| cuts.max(of(square))).collect();
            more = added(&next);
            if more > room {
                return (all, more);
            }
            all = next;
            if left <= (CLEAR * allowed).powi(2) || limit <= f64::EPSILON * most {
                break;
            }
        }
    }
    (all, more)
}

/// Triangles that so many cuts of each add.
pub(super) fn added(cuts: &[u32]) -> usize {
    cuts.iter().map(|&times| 4_usize.pow(times) - 1).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(squares: &[f64]) -> MeshError {
        MeshError::new(squares, &|_| DVec3::X, 1.0)
    }

    #[test]
    fn the_worst_are_cut_until_errors_are_expected_to_be_allowed() {
        let error = of(&[1e-2, 1e-6, 2e-3, 0.0, 1e-6]);
        let (times, more) = cuts(std::slice::from_ref(&error), 0.05, 1000);
        assert_eq!((&times[..], more), (&[1, 0, 1, 0, 0][..], 6));
        let (times, _) = cuts(std::slice::from_ref(&error), 0.02, 1000);
        assert_eq!(times, [2, 0, 1, 0, 0]);
        assert_eq!(cuts(&[error], 0.2, 1000), (vec![0; 5], 0), "it is allowed already");
    }

    #[test]
    fn there_is_room_for_the_worst_alone() {
        let (times, more) = cuts(&[of(&[1e-2, 2e-3, 2e-3])], 0.02, 5);
        assert_eq!(times, [1, 0, 0]);
        assert!(more > 5, "{more}");
    }

    #[test]
    fn every_error_has_its_own_triangles() {
        let (times, _) = cuts(&[of(&[1e-2, 0.0]), of(&[0.0, 1e-2]), of(&[f64::NAN, 1.0])], 0.05, 1000);
        assert_eq!(times, [1, 1]);
    }
}
