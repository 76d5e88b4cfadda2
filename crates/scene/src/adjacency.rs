//! Mesh adjacency: which vertices coincide, and which triangles share an edge or a corner.
//!
//! Files often write a corner once for each triangle, so adjacency goes by positions, not by indices. All orders depend on
//! the input alone.

use std::collections::HashMap;

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

/// Coincident vertices, welded into one position each.
#[derive(Clone, Debug)]
pub struct Welded {
    /// Per vertex, the index of its position.
    pub position: Vec<u32>,
    /// Per position, the first vertex there: positions are numbered in order of appearance.
    pub first: Vec<u32>,
}

impl Welded {
    /// Welds vertices with identical coordinates.
    pub fn exactly(vertices: impl IntoIterator<Item = DVec3>) -> Self {
        let mut known = HashMap::new();
        Self::by(vertices, |vertex, new| {
            // Adding zero turns -0 into +0.
            *known.entry((vertex + DVec3::ZERO).to_array().map(f64::to_bits)).or_insert(new)
        })
    }

    /// Welds each vertex to the first one within a distance, which must not be zero.
    pub fn within(tolerance: f64, vertices: impl IntoIterator<Item = DVec3>) -> Self {
        let cell = |x: DVec3| (x / (2.0 * tolerance)).floor().as_i64vec3();
        let mut cells: HashMap<I64Vec3, Vec<(u32, DVec3)>> = HashMap::new();
        Self::by(vertices, |vertex, new| {
            // Any vertex within the tolerance is in one of the cells at the corners of a cube around this one.
            for corner in 0..8 {
                let side = |axis: u32| if corner >> axis & 1 == 1 { tolerance } else { -tolerance };
                let near = cells.get(&cell(vertex + DVec3::new(side(0), side(1), side(2))));
                let mut near = near.into_iter().flatten();
                if let Some(&(known, _)) = near.find(|(_, other)| other.distance(vertex) <= tolerance) {
                    return known;
                }
            }
            cells.entry(cell(vertex)).or_default().push((new, vertex));
            new
        })
    }

    /// `index_of` returns the index of a position, given the index for a new one.
    fn by(vertices: impl IntoIterator<Item = DVec3>, mut index_of: impl FnMut(DVec3, u32) -> u32) -> Self {
        let mut welded = Self { position: Vec::new(), first: Vec::new() };
        for vertex in vertices {
            let new = welded.first.len() as u32;
            let index = index_of(vertex, new);
            if index == new {
                welded.first.push(welded.position.len() as u32);
            }
            welded.position.push(index);
        }
        welded
    }

    /// The positions of a triangle's vertices.
    pub fn positions(&self, vertices: [u32; 3]) -> [u32; 3] {
        vertices.map(|v| self.position[v as usize])
    }
}

/// The directed edges of a triangle.
pub fn sides([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// An edge in the direction in which one of its triangles runs along it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Side {
    low: u32,
    high: u32,
    pub triangle: u32,
    /// Whether it runs from the lower to the higher vertex.
    forward: bool,
}

/// The sides along one edge, by ascending triangle; never empty.
#[derive(Clone, Copy)]
pub struct Edge<'a>(&'a [Side]);

impl<'a> Edge<'a> {
    /// The vertices, the lower one first.
    pub fn ends(&self) -> [u32; 2] {
        [self.0[0].low, self.0[0].high]
    }

    pub fn triangles(&self) -> impl Iterator<Item = u32> + Clone {
        self.0.iter().map(|side| side.triangle)
    }

    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// The two triangles of the edge, if it has exactly two.
    pub fn pair(&self) -> Option<[u32; 2]> {
        match self.0 {
            [a, b] => Some([a.triangle, b.triangle]),
            _ => None,
        }
    }

    /// Number of triangles that run along the edge from the lower to the higher vertex, minus those that run
    /// back.
    pub fn balance(&self) -> i64 {
        self.0.iter().map(|side| if side.forward { 1 } else { -1 }).sum()
    }

    /// Each triangle of the edge, and the vertices in the direction in which it runs.
    pub fn directed(self) -> impl Iterator<Item = (u32, [u32; 2])> + 'a {
        self.0.iter().map(|side| {
            let ends = if side.forward { [side.low, side.high] } else { [side.high, side.low] };
            (side.triangle, ends)
        })
    }
}

/// The triangles along each edge.
pub struct Edges {
    /// Sorted, so that the sides of an edge are consecutive.
    sides: Vec<Side>,
}

impl Edges {
    /// The edges of triangles, from their directed sides; sides from a vertex to itself are left out.
    pub fn new(directed: impl IntoIterator<Item = (u32, [u32; 2])>) -> Self {
        let real = directed.into_iter().filter(|(_, [a, b])| a != b);
        let side = |(triangle, [a, b]): (u32, [u32; 2])| Side {
            low: a.min(b),
            high: a.max(b),
            triangle,
            forward: a < b,
        };
        let mut sides: Vec<Side> = real.map(side).collect();
        sides.par_sort_unstable();
        Self { sides }
    }

    /// The edges of triangles, which are numbered in their order.
    pub fn of(triangles: impl IntoIterator<Item = [u32; 3]>) -> Self {
        Self::new((0..).zip(triangles).flat_map(|(t, corners)| sides(corners).map(|side| (t, side))))
    }

    /// All edges, by ascending vertices.
    pub fn iter(&self) -> impl Iterator<Item = Edge<'_>> {
        self.sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)).map(Edge)
    }
}

/// The triangles around each vertex.
#[derive(Clone, Debug)]
pub struct Fans {
    /// Vertex v has `triangles[start[v]..start[v + 1]]`.
    start: Vec<u32>,
    triangles: Vec<u32>,
}

impl Fans {
    /// The triangles around each of a number of vertices. Triangles are numbered in their order.
    pub fn of(vertices: usize, triangles: impl Iterator<Item = [u32; 3]> + Clone) -> Self {
        let corners = || (0u32..).zip(triangles.clone()).flat_map(|(t, abc)| abc.map(|v| (v as usize, t)));
        let mut start = vec![0; vertices + 1];
        for (vertex, _) in corners() {
            start[vertex + 1] += 1;
        }
        for vertex in 0..vertices {
            start[vertex + 1] += start[vertex];
        }
        let mut end = start.clone();
        let mut around = vec![0; start[vertices] as usize];
        for (vertex, triangle) in corners() {
            around[end[vertex] as usize] = triangle;
            end[vertex] += 1;
        }
        Self { start, triangles: around }
    }

    /// Triangles around a vertex, ascending.
    pub fn around(&self, vertex: u32) -> &[u32] {
        let vertex = vertex as usize;
        &self.triangles[self.start[vertex] as usize..self.start[vertex + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles of a square, each with corners of its own, one of them off by one bit.
    fn square(off: f64) -> [DVec3; 6] {
        let [a, b, c, d] = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
        [a, b, c, -a, c + DVec3::splat(off), d]
    }

    #[test]
    fn coinciding_vertices_are_welded() {
        let exact = Welded::exactly(square(0.0));
        assert_eq!((exact.position, exact.first), (vec![0, 1, 2, 0, 2, 3], vec![0, 1, 2, 5]));
        assert_eq!(Welded::exactly(square(1e-9)).position, [0, 1, 2, 0, 3, 4]);
        for off in [1e-9, -1e-9] {
            assert_eq!(Welded::within(1e-6, square(off)).position, [0, 1, 2, 0, 2, 3]);
        }
        assert_eq!(Welded::within(1e-6, square(1e-5)).position, [0, 1, 2, 0, 3, 4]);
    }

    #[test]
    fn edges_know_their_triangles_and_which_way_they_run() {
        let triangles = [[0, 1, 2], [0, 2, 3], [2, 2, 1], [2, 0, 4]];
        let edges = Edges::of(triangles);
        let all: Vec<_> =
            edges.iter().map(|e| (e.ends(), e.triangles().collect::<Vec<_>>(), e.balance())).collect();
        let expected = [
            ([0, 1], vec![0], 1),
            ([0, 2], vec![0, 1, 3], -1),
            ([0, 3], vec![1], -1),
            ([0, 4], vec![3], 1),
            ([1, 2], vec![0, 2, 2], 1),
            ([2, 3], vec![1], 1),
            ([2, 4], vec![3], -1),
        ];
        assert_eq!(all, expected);
        let diagonal = edges.iter().find(|e| e.ends() == [0, 2]).map(|e| e.directed().collect::<Vec<_>>());
        assert_eq!(diagonal, Some(vec![(0, [2, 0]), (1, [0, 2]), (3, [2, 0])]));
        let fans = Fans::of(5, triangles.into_iter());
        assert_eq!((fans.around(0), fans.around(3), fans.around(1)), (&[0, 1, 3][..], &[1][..], &[0, 2][..]));
    }

    /// A grid of 200 000 triangles, each with three vertices of its own.
    #[test]
    fn a_large_mesh_is_put_together() {
        let n = 316;
        let at = |i: i32, j: i32| DVec3::new(f64::from(i), f64::from(j), 0.0);
        let cell =
            |i, j| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)];
        let corners: Vec<DVec3> = (0..n).flat_map(|i| (0..n).flat_map(move |j| cell(i, j))).collect();
        let triangles = corners.len() as u32 / 3;
        for welded in
            [Welded::exactly(corners.iter().copied()), Welded::within(1e-3, corners.iter().copied())]
        {
            assert_eq!(welded.first.len(), (n as usize + 1).pow(2));
            let edges = Edges::of((0..triangles).map(|t| welded.positions([3 * t, 3 * t + 1, 3 * t + 2])));
            let inner = edges.iter().filter(|edge| edge.len() == 2 && edge.balance() == 0).count();
            let rim = edges.iter().filter(|edge| edge.len() == 1).count();
            assert_eq!((inner, rim), ((3 * n * n - 2 * n) as usize, 4 * n as usize));
        }
    }
}
