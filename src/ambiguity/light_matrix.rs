//! Light between triangles in numbers.

/// Irradiance on all triangles (rows) per radiance of each of some triangles (columns), sr.
#[derive(Clone, Debug, PartialEq)]
pub struct LightMatrix {
    rows: usize,
    /// Column by column.
    values: Vec<f64>,
}

impl LightMatrix {
    /// Of no columns yet.
    pub(super) fn new(rows: usize) -> Self {
        Self { rows, values: Vec::new() }
    }

    /// Adds a column of one value per row.
    pub(super) fn push(&mut self, column: impl IntoIterator<Item = f64>) {
        self.values.extend(column);
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    pub fn columns(&self) -> usize {
        self.values.len() / self.rows.max(1)
    }

    /// Panics outside of the matrix.
    pub fn get(&self, row: usize, column: usize) -> f64 {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        self.values[column * self.rows + row]
    }
}
