//! The polytope of all emissions that explain a set of pictures.

use super::{LightMatrix, packing};
use antirad_base::parallel;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::Serialize;
use std::f64::consts::PI;

/// The polytope could not be constructed or searched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PolytopeError {
    /// Interreflection between unseen triangles does not converge.
    #[error(
        "interreflection between unseen triangles does not converge: its spectral radius is not below 1; lower their albedo"
    )]
    Singular,
    /// The simplex method did not end.
    #[error("the linear program of triangle {triangle} was not solved to the end")]
    Unfinished {
        /// Index in the scene.
        triangle: usize,
    },
}

/// How the ends of an interval were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// A vertex of the polytope, in closed form.
    ClosedForm,
    /// The simplex method.
    LinearProgram,
}

/// The range of a triangle's emission in one channel over all explanations, W/(m² sr).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The lower end.
    pub least: f64,
    /// The upper end; `None` if unbounded, because no seen triangle receives this triangle's light.
    pub most: Option<f64>,
    /// How both ends were found.
    pub method: Method,
}

/// One channel: e_u ≥ 0, A e_u ≤ s + τ, and e_v = s - A e_u.
///
/// Incident light is not negative except for discretisation errors: A and s have small negative entries, which the bounds
/// treat as zero. With A ≥ 0 and s ≥ 0, unseen triangles can always be dark, and each is brightest when all others are dark.
/// The known explanation always counts as one, whatever the discretisation error.
pub struct Polytope {
    unseen: Vec<usize>,
    seen: Vec<usize>,
    /// A: rows are seen triangles, columns unseen ones.
    a: DMatrix<f64>,
    /// s: the emission of each seen triangle if no unseen one emits.
    alone: DVector<f64>,
    noise: f64,
    /// The known explanation e*, per triangle of the scene.
    emission: Vec<f64>,
    areas: Vec<f64>,
    /// Cholesky factor of the Gram matrix of a basis of the changes that pictures do not show.
    gram: Cholesky<f64, Dyn>,
    /// The most negative entry of s relative to its mean, or zero: the discretisation error in shadows.
    pub lowest: f64,
}

/// Input of [`Polytope::new`], for one channel.
pub struct Given<'a> {
    /// Irradiance on all triangles per radiance of the unseen ones, sr, [`DirectLight::columns`](super::DirectLight::columns).
    pub direct: &'a LightMatrix,
    /// δρ, per triangle.
    pub albedo: &'a [f64],
    /// An explanation of the picture, radiance, per triangle.
    pub emission: &'a [f64],
    /// m², per triangle.
    pub areas: &'a [f64],
    /// Whether a camera sees it, per triangle.
    pub seen: &'a [bool],
    /// The columns of `direct`.
    pub unseen: &'a [usize],
    /// Tolerance τ on the radiance of seen triangles, relative to the mean of s.
    pub noise: f64,
}

impl Polytope {
    /// Computes A and s.
    ///
    /// # Errors
    /// Fails if interreflection between unseen triangles does not converge.
    pub fn new(given: &Given) -> Result<Self, PolytopeError> {
        let Given { direct, albedo, emission, areas, .. } = *given;
        let unseen = given.unseen.to_vec();
        let seen: Vec<usize> = (0..albedo.len()).filter(|&i| given.seen[i]).collect();
        let reflected = |rows: &[usize]| {
            DMatrix::from_fn(rows.len(), unseen.len(), |i, u| albedo[rows[i]] / PI * direct.get(rows[i], u))
        };
        let among_unseen = DMatrix::identity(unseen.len(), unseen.len()) - reflected(&unseen);
        // A (1 - R_uu) = R_vu. Matrices without rows have no decomposition.
        let a = match unseen.is_empty() {
            true => DMatrix::zeros(seen.len(), 0),
            false => among_unseen
                .transpose()
                .lu()
                .solve(&reflected(&seen).transpose())
                .ok_or(PolytopeError::Singular)?
                .transpose(),
        };
        let of = |rows: &[usize]| DVector::from_iterator(rows.len(), rows.iter().map(|&i| emission[i]));
        let alone = of(&seen) + &a * of(&unseen);

        let mut weighted = a.clone();
        for (mut row, &i) in weighted.row_iter_mut().zip(&seen) {
            row *= areas[i];
        }
        let mut gram = a.transpose() * weighted;
        for (k, &u) in unseen.iter().enumerate() {
            gram[(k, k)] += areas[u];
        }
        let gram = Cholesky::new(gram).ok_or(PolytopeError::Singular)?;
        let mean = alone.iter().sum::<f64>() / alone.len().max(1) as f64;
        let noise = given.noise * mean;
        let lowest = alone.iter().copied().fold(0.0, f64::min) / mean;
        Ok(Self {
            unseen,
            seen,
            a,
            alone,
            noise,
            emission: emission.to_vec(),
            areas: areas.to_vec(),
            gram,
            lowest,
        })
    }

    /// Dimension of the space of emissions that give the same picture, positive or not.
    pub fn dimension(&self) -> usize {
        self.unseen.len()
    }

    /// The explanation with given emissions of the unseen triangles (radiance, by ascending triangle), per triangle of the
    /// scene: e_v = s - A e_u. Within the polytope none is below -τ, except for discretisation errors.
    pub fn explanation(&self, unseen: &[f64]) -> Vec<f64> {
        let mut emission = vec![0.0; self.areas.len()];
        let rest = &self.alone - &self.a * DVector::from_column_slice(unseen);
        self.unseen.iter().zip(unseen).for_each(|(&i, &e)| emission[i] = e);
        self.seen.iter().zip(rest.iter()).for_each(|(&i, &e)| emission[i] = e);
        emission
    }

    /// The interval of each unseen triangle, ascending. At its lower end the triangle is dark, at its upper end it is the only
    /// unseen one that emits.
    pub fn unseen_intervals(&self) -> Vec<Interval> {
        let brightest = |k: usize| {
            let column = self.a.column(k);
            let room = self.alone.iter().zip(column.iter()).filter(|(_, a)| **a > 0.0);
            let most = room.map(|(s, a)| (s.max(0.0) + self.noise) / a).fold(f64::INFINITY, f64::min);
            let most = most.max(self.emission[self.unseen[k]]);
            Interval { least: 0.0, most: most.is_finite().then_some(most), method: Method::ClosedForm }
        };
        parallel::map(0..self.unseen.len(), brightest)
    }

    /// The interval of a seen triangle (by its index in the scene); `None` if it is not seen. The upper end is its emission when
    /// no unseen triangle emits; the lower end takes a linear program: maximise (A e_u)_k within the polytope.
    ///
    /// # Errors
    /// Fails if the linear program is not solved to the end.
    pub fn seen_interval(&self, triangle: usize) -> Result<Option<Interval>, PolytopeError> {
        let Ok(k) = self.seen.binary_search(&triangle) else { return Ok(None) };
        let positive = |row: usize| -> Vec<f64> { self.a.row(row).iter().map(|a| a.max(0.0)).collect() };
        let rooms = self.alone.iter().enumerate().map(|(row, s)| (positive(row), s.max(0.0) + self.noise));
        let brightest = packing::most(rooms, &positive(k)).ok_or(PolytopeError::Unfinished { triangle })?;
        let (most, own) = (self.alone[k] + self.noise, self.emission[triangle]);
        let least = (self.alone[k] - self.noise - brightest).max(0.0);
        let (most, least) = (most.max(own), least.min(own));
        Ok(Some(Interval { least, most: Some(most), method: Method::LinearProgram }))
    }

    /// How well pictures determine each triangle's emission, 0 to 1: the fraction of a change of it alone, in the area-weighted
    /// mean square, that no change of others can compensate. NaN for triangles that are neither seen nor listed as unseen.
    pub fn determination(&self) -> Vec<f64> {
        let mut determined = vec![f64::NAN; self.areas.len()];
        // 1 - a_k |L⁻¹ d_k|², d_k the row of [1; -A], L L^T the Gram matrix.
        let l = self.gram.l();
        let squares = |rows: DMatrix<f64>| -> Vec<f64> {
            let mut rows = rows;
            l.solve_lower_triangular_mut(&mut rows);
            rows.column_iter().map(|column| column.norm_squared()).collect()
        };
        let n = self.unseen.len();
        for (&u, square) in self.unseen.iter().zip(squares(DMatrix::identity(n, n))) {
            determined[u] = 1.0 - self.areas[u] * square;
        }
        for (&v, square) in self.seen.iter().zip(squares(self.a.transpose())) {
            determined[v] = 1.0 - self.areas[v] * square;
        }
        determined
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two unseen triangles (0, 1) and two seen ones (2, 3). Triangle 0 illuminates 2 and 3, triangle 1 no seen triangle.
    fn polytope(noise: f64) -> Polytope {
        let mut direct = LightMatrix::new(4);
        direct.push([0.0, 0.4, 0.2, 0.1].map(|part| part * PI));
        direct.push([0.0; 4]);
        Polytope::new(&Given {
            direct: &direct,
            albedo: &[0.5; 4],
            emission: &[3.0, 1.0, 0.0, 2.0],
            areas: &[1.0, 2.0, 1.0, 1.0],
            seen: &[false, false, true, true],
            unseen: &[0, 1],
            noise,
        })
        .expect("a polytope")
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12
    }

    /// s = (0.3, 2.15), so that triangle 0 emits at most min(0.3/0.1, 2.15/0.05).
    #[test]
    fn intervals_of_four_triangles() {
        let polytope = polytope(0.0);
        let intervals = polytope.unseen_intervals();
        assert!(close(intervals[0].most.expect("a bound"), 3.0), "{intervals:?}");
        assert_eq!((intervals[0].least, intervals[1].most), (0.0, None));
        let seen = |i| polytope.seen_interval(i).expect("an interval").expect("seen");
        // All the light of triangle 2 may come from triangle 0; triangle 3 then emits 0.15 less.
        assert!(close(seen(2).least, 0.0) && close(seen(2).most.expect("a bound"), 0.3));
        assert!(close(seen(3).least, 2.0) && close(seen(3).most.expect("a bound"), 2.15));
        assert_eq!(polytope.seen_interval(0).expect("an answer"), None);
        assert_eq!(polytope.dimension(), 2);
    }

    #[test]
    fn explanations_share_the_picture() {
        let polytope = polytope(0.0);
        assert!(
            polytope.explanation(&[3.0, 1.0]).iter().zip([3.0, 1.0, 0.0, 2.0]).all(|(a, b)| close(*a, b))
        );
        assert!(
            polytope.explanation(&[0.0, 0.0]).iter().zip([0.0, 0.0, 0.3, 2.15]).all(|(a, b)| close(*a, b))
        );
    }

    /// Pictures that show all triangles determine them.
    #[test]
    fn nothing_is_unseen() {
        let polytope = Polytope::new(&Given {
            direct: &LightMatrix::new(2),
            albedo: &[0.5; 2],
            emission: &[3.0, 0.0],
            areas: &[1.0, 2.0],
            seen: &[true; 2],
            unseen: &[],
            noise: 0.0,
        })
        .expect("a polytope");
        assert_eq!((polytope.dimension(), polytope.unseen_intervals()), (0, Vec::new()));
        assert_eq!(polytope.determination(), [1.0, 1.0]);
        assert_eq!(polytope.explanation(&[]), [3.0, 0.0]);
        let lamp = polytope.seen_interval(0).expect("an interval").expect("seen");
        assert!(close(lamp.least, 3.0) && close(lamp.most.expect("a bound"), 3.0));
    }

    /// Noise widens all intervals.
    #[test]
    fn noise_widens() {
        let (exact, noisy) = (polytope(0.0), polytope(0.1));
        let of = |p: &Polytope| p.seen_interval(3).expect("an interval").expect("seen");
        assert!(of(&noisy).least < of(&exact).least && of(&noisy).most > of(&exact).most);
        assert!(noisy.unseen_intervals()[0].most > exact.unseen_intervals()[0].most);
    }

    /// The projection onto changes that pictures show, written out: for triangle 0, d = (1, 0, -0.1, -0.05).
    #[test]
    fn determination_of_four_triangles() {
        let determined = polytope(0.0).determination();
        let norm = 1.0 + 0.01 + 0.0025;
        for (i, expected) in
            [1.0 - 1.0 / norm, 0.0, 1.0 - 0.01 / norm, 1.0 - 0.0025 / norm].iter().enumerate()
        {
            assert!(close(determined[i], *expected), "{i}: {determined:?}");
        }
    }
}
