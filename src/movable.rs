//! The vertices by whose positions derivatives are wanted.

/// Some vertices of a scene, and the triangles that move with them.
#[derive(Clone, Debug)]
pub(crate) struct Movable {
    vertices: Vec<bool>,
    triangles: Vec<bool>,
}

impl Movable {
    /// `count`: all vertices of the scene; further ones in `movable` are ignored.
    pub fn new(count: usize, movable: &[u32], triangles: impl Iterator<Item = [u32; 3]>) -> Self {
        let mut vertices = vec![false; count];
        for &vertex in movable {
            if let Some(of) = vertices.get_mut(vertex as usize) {
                *of = true;
            }
        }
        let moves = |corners: [u32; 3]| corners.iter().any(|&vertex| vertices[vertex as usize]);
        let triangles = triangles.map(moves).collect();
        Self { vertices, triangles }
    }

    /// Whether a vertex is movable.
    pub fn vertex(&self, vertex: u32) -> bool {
        self.vertices[vertex as usize]
    }

    /// Whether a corner of a triangle is.
    pub fn triangle(&self, triangle: usize) -> bool {
        self.triangles[triangle]
    }
}
