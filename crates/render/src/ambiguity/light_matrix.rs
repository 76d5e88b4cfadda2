//! Transport between triangles as a dense matrix.

/// Irradiance on all triangles (rows) per radiance of some triangles (columns), sr.
#[derive(Clone, Debug, PartialEq)]
pub struct LightMatrix {
    rows: usize,
    /// Column by column.
    values: Vec<f64>,
}

impl LightMatrix {
    /// A matrix without columns.
    pub(super) fn new(rows: usize) -> Self {
        Self { rows, values: Vec::new() }
    }

    /// Adds a column of one value per row.
    pub(super) fn push(&mut self, column: impl IntoIterator<Item = f64>) {
        self.values.extend(column);
    }

    /// Number of rows, one per triangle of the scene.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns, one per source.
    pub fn columns(&self) -> usize {
        self.values.len() / self.rows.max(1)
    }

    /// An entry. Panics if the indices are out of range.
    pub fn get(&self, row: usize, column: usize) -> f64 {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        self.values[column * self.rows + row]
    }
}
