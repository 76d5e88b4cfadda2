//! The vertices by whose positions derivatives are wanted.

/// Vertices of a scene, and the triangles that move with them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Movable {
    /// Every vertex.
    All,
    /// The marked vertices.
    Some {
        /// Per vertex of the scene, whether it is movable.
        vertices: Vec<bool>,
        /// Per triangle, whether a corner is movable.
        triangles: Vec<bool>,
    },
}

impl Movable {
    /// Some of `count` vertices, by their indices, of which further ones are ignored; or all.
    pub fn of(count: usize, movable: Option<&[u32]>, triangles: impl Iterator<Item = [u32; 3]>) -> Self {
        let Some(movable) = movable else { return Self::All };
        let mut vertices = vec![false; count];
        for &vertex in movable {
            if let Some(of) = vertices.get_mut(vertex as usize) {
                *of = true;
            }
        }
        let moves = |corners: [u32; 3]| corners.iter().any(|&vertex| vertices[vertex as usize]);
        let triangles = triangles.map(moves).collect();
        Self::Some { vertices, triangles }
    }

    /// Whether a vertex is movable.
    pub fn vertex(&self, vertex: u32) -> bool {
        match self {
            Self::All => true,
            Self::Some { vertices, .. } => vertices[vertex as usize],
        }
    }

    /// Whether a corner of a triangle is movable.
    pub fn triangle(&self, triangle: u32) -> bool {
        match self {
            Self::All => true,
            Self::Some { triangles, .. } => triangles[triangle as usize],
        }
    }
}
