//! Similarities: rotation, uniform scale and translation.

use glam::{DMat3, DVec3};

/// How far the part of a matrix that rotates and scales may be from a multiple of a rotation.
const RIGID: f64 = 1e-4;

/// A map from the world of a set of cameras to that of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    rotation: DMat3,
    scale: f64,
    translation: DVec3,
}

impl Similarity {
    /// From the rows of a matrix, 3 x 4 or 4 x 4, that acts on columns (x, y, z, 1).
    ///
    /// # Errors
    /// Says what is wrong if the matrix has another size, is not finite, mirrors, or scales the axes differently.
    pub fn from_rows(rows: &[Vec<f64>]) -> Result<Self, String> {
        let [x, y, z, translation] = affine(rows)?;
        let linear = DMat3::from_cols(x, y, z);
        let scale = linear.determinant().abs().cbrt();
        let square = linear.transpose() * linear;
        let off = (square - DMat3::from_diagonal(DVec3::splat(scale * scale))).to_cols_array();
        let most = off.into_iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        // The negation also refuses a scale that is not a number.
        if !(scale > 0.0 && scale.is_finite() && most <= RIGID * scale * scale) {
            return Err("it is no similarity: its first three columns must be equally long, not zero, and at right angles".to_owned());
        }
        if linear.determinant() < 0.0 {
            return Err("it mirrors the world; negate one of its first three columns or rows".to_owned());
        }
        Ok(Self { rotation: linear * scale.recip(), scale, translation })
    }

    /// The image of a point.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// The image of a direction, of unit length.
    pub fn direction(&self, direction: DVec3) -> DVec3 {
        (self.rotation * direction).normalize_or_zero()
    }
}

/// The columns of a matrix given by rows, 3 x 4 or 4 x 4 with (0, 0, 0, 1) below. Says what is wrong with it.
pub(super) fn affine(rows: &[Vec<f64>]) -> Result<[DVec3; 4], String> {
    if !(3..=4).contains(&rows.len()) || rows.iter().any(|row| row.len() != 4) {
        let longest = rows.iter().map(Vec::len).max().unwrap_or(0);
        return Err(format!(
            "it has {} rows of up to {longest} numbers; give 4 rows of 4, or the first 3 of them",
            rows.len()
        ));
    }
    if rows.iter().flatten().any(|value| !value.is_finite()) {
        return Err("it has a number that is not finite; correct it".to_owned());
    }
    if rows
        .get(3)
        .is_some_and(|last| last.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > 1e-9))
    {
        return Err("its last row is not 0, 0, 0, 1; give the matrix by rows, with the translation in the last column".to_owned());
    }
    Ok([0, 1, 2, 3].map(|column| DVec3::new(rows[0][column], rows[1][column], rows[2][column])))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rows: [[f64; 4]; 3]) -> Result<Similarity, String> {
        Similarity::from_rows(&rows.map(|row| row.to_vec()))
    }

    #[test]
    fn similarities_map_points_and_directions() {
        // A quarter turn about z, twice as large, one up.
        let map =
            of([[0.0, -2.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0, 1.0]]).expect("a similarity");
        assert!(map.point(DVec3::new(1.0, 0.0, 3.0)).abs_diff_eq(DVec3::new(0.0, 2.0, 7.0), 1e-12));
        assert!(map.direction(DVec3::Y).abs_diff_eq(DVec3::NEG_X, 1e-12));
    }

    #[test]
    fn other_matrices_are_refused() {
        let one = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let with = |row: usize, column: usize, value: f64| {
            let mut rows = one;
            rows[row][column] = value;
            rows
        };
        for (rows, part) in [
            (with(0, 0, 2.0), "no similarity"),
            (with(0, 1, 0.1), "no similarity"),
            (with(0, 0, -1.0), "mirrors"),
            (with(0, 0, 0.0), "no similarity"),
            (with(1, 3, f64::INFINITY), "not finite"),
            ([[1e200, 0.0, 0.0, 0.0], [0.0, 1e200, 0.0, 0.0], [0.0, 0.0, 1e200, 0.0]], "no similarity"),
        ] {
            let error = of(rows).expect_err(part);
            assert!(error.contains(part), "{error}");
        }
        let mut rows: Vec<Vec<f64>> = one.map(|row| row.to_vec()).to_vec();
        rows.push(vec![0.0, 0.0, 1.0, 1.0]);
        assert!(Similarity::from_rows(&rows).expect_err("a projection").contains("last row"));
        assert!(Similarity::from_rows(&rows[..2]).expect_err("two rows").contains("2 rows"));
        assert!(Similarity::from_rows(&[]).is_err());
    }
}
