//! Connected pieces of surface, and which way they face.
//!
//! Files often have single faces turned, or whole shells inside out. Where a shell is closed or nearly so, two rules mend that:
//! faces that disagree with most of their shell are turned, and a shell that lets no lamp see its fronts, but its backs, is turned as
//! a whole. Open sheets are left alone: either side may be meant.

use std::collections::VecDeque;
use std::sync::Arc;

use glam::DVec3;

use super::{Edges, Rays, Scene, Welded, bounds};

/// Vertices closer than this fraction of the scene's size count as one.
const WELD: f64 = 1e-6;
/// The length of the sum of area vectors over the area, below which a shell counts as nearly closed. It is 0 for closed shells, 0.2
/// for a cube without one of its faces, 0.5 for half a sphere, 1 for a flat sheet.
const NEARLY_CLOSED: f64 = 0.4;
/// Triangles of a shell, and of all lamps, that are tried to see one another.
const TRIED: usize = 64;

/// A connected piece of surface, whose triangles meet two by two along edges.
pub(super) struct Shell {
    /// Indices of the triangles, ascending.
    pub triangles: Vec<u32>,
    /// Triangles that disagree with the rest about the front, the smaller part by area; none if the shell
    /// cannot be oriented.
    pub against: Vec<u32>,
    /// Whether it has no edge that a single triangle has, and can be oriented.
    pub closed: bool,
    /// See [`NEARLY_CLOSED`], once all triangles agree.
    openness: f64,
}

/// The shells of a scene, by their first triangles.
pub(super) fn shells(scene: &Scene) -> Vec<Shell> {
    let count = scene.triangles.len();
    let (low, high) = bounds(scene.vertices.iter().copied());
    let tolerance = WELD * (high - low).max_element();
    let welded = match tolerance > 0.0 && tolerance.is_finite() {
        true => Welded::within(tolerance, scene.vertices.iter().copied()),
        false => Welded::exactly(scene.vertices.iter().copied()),
    };
    // Per triangle, the neighbours along its edges and whether they agree about the front; and whether an edge is open.
    let mut neighbours: Vec<Vec<(u32, bool)>> = vec![Vec::new(); count];
    let mut open = vec![false; count];
    let edges = Edges::of(scene.triangles.iter().map(|t| welded.positions(t.vertices)));
    for edge in edges.iter() {
        match edge.pair() {
            Some([a, b]) if a != b => {
                let agree = edge.balance() == 0;
                neighbours[a as usize].push((b, agree));
                neighbours[b as usize].push((a, agree));
            }
            _ => edge.triangles().for_each(|t| open[t as usize] = true),
        }
    }
    let area = |t: u32| scene.area_vector(t as usize).length();
    let mut side: Vec<Option<bool>> = vec![None; count];
    let mut shells = Vec::new();
    for first in 0..count as u32 {
        if side[first as usize].is_some() {
            continue;
        }
        let (mut triangles, mut orientable) = (vec![first], true);
        side[first as usize] = Some(true);
        let mut waiting = VecDeque::from([first]);
        while let Some(t) = waiting.pop_front() {
            let own = side[t as usize] == Some(true);
            for &(other, agree) in &neighbours[t as usize] {
                let theirs = own == agree;
                match side[other as usize] {
                    None => {
                        side[other as usize] = Some(theirs);
                        triangles.push(other);
                        waiting.push_back(other);
                    }
                    Some(known) => orientable &= known == theirs,
                }
            }
        }
        triangles.sort_unstable();
        let share = |which: bool| -> f64 {
            triangles.iter().filter(|&&t| side[t as usize] == Some(which)).map(|&t| area(t)).sum()
        };
        let (this, that) = (share(true), share(false));
        let minority = this < that;
        let against: Vec<u32> =
            triangles.iter().copied().filter(|&t| orientable && side[t as usize] == Some(minority)).collect();
        let sum: DVec3 = triangles
            .iter()
            .map(|&t| {
                let vector = scene.area_vector(t as usize);
                if side[t as usize] == Some(true) { vector } else { -vector }
            })
            .sum();
        let openness = sum.length() / (this + that).max(f64::MIN_POSITIVE);
        let closed = orientable && !triangles.iter().any(|&t| open[t as usize]);
        shells.push(Shell { triangles, against, closed, openness });
    }
    shells
}

/// Turns faces where a closed or nearly closed shell says which way they should face. Shells with a triangle for which `keep` holds stay
/// as they are. Returns how many triangles were turned, by mesh.
pub(super) fn orient(scene: &mut Scene, keep: impl Fn(usize) -> bool) -> Vec<(String, usize)> {
    let shells = shells(scene);
    let mendable = |shell: &&Shell| {
        shell.openness <= NEARLY_CLOSED
            && shell.triangles.len() > 3
            && !shell.triangles.iter().any(|&t| keep(t as usize))
    };
    let mendable: Vec<&Shell> = shells.iter().filter(mendable).collect();
    if mendable.is_empty() {
        return Vec::new();
    }
    let mut shell_of = vec![0; scene.triangles.len()];
    for (k, shell) in shells.iter().enumerate() {
        shell.triangles.iter().for_each(|&t| shell_of[t as usize] = k);
    }
    let before = scene.triangles.clone();
    let patterned = !scene.patterns.is_bare();
    let turn = |scene: &mut Scene, triangles: &[u32]| {
        for &t in triangles {
            scene.triangles[t as usize].vertices.swap(1, 2);
            if patterned {
                Arc::make_mut(&mut scene.patterns).turn(t as usize);
            }
        }
    };
    mendable.iter().for_each(|shell| turn(scene, &shell.against));
    let light = Light::new(scene, &shell_of);
    let inside_out: Vec<&Shell> =
        mendable.into_iter().filter(|shell| light.falls_on_backs_of(shell)).collect();
    inside_out.into_iter().for_each(|shell| turn(scene, &shell.triangles));
    let turned = |t: &u32| scene.triangles[*t as usize] != before[*t as usize];
    let of_mesh = |mesh: &super::Mesh| (mesh.name.clone(), mesh.range.clone().filter(turned).count());
    scene.meshes.iter().map(of_mesh).filter(|(_, count)| *count > 0).collect()
}

/// The lamps of a scene, and rays that tell from where they can be seen.
struct Light<'a> {
    scene: &'a Scene,
    rays: Arc<Rays>,
    lamps: Vec<usize>,
    shell_of: &'a [usize],
}

impl<'a> Light<'a> {
    fn new(scene: &'a Scene, shell_of: &'a [usize]) -> Self {
        let shines = |&t: &usize| scene.shines(t);
        let lamps = (0..scene.triangles.len()).filter(shines).collect();
        Self { scene, rays: scene.rays(), lamps, shell_of }
    }

    /// Whether a shell is dark as it faces, and would not be if it faced the other way.
    fn falls_on_backs_of(&self, shell: &Shell) -> bool {
        let lit = shell.triangles.iter().filter(|&&t| self.scene.shines(t as usize)).count();
        if lit == 0 {
            let [front, back] = self.lamps_seen(shell);
            front == 0 && back > 0
        } else {
            let all = lit == shell.triangles.len();
            let front = self.hits(shell, 1.0);
            let back = self.hits(shell, -1.0);
            // A lamp shines on something else. A room with a lamp in its walls shines on itself.
            if all { front.other == 0 && back.other > 0 } else { front.any == 0 && back.any > 0 }
        }
    }

    /// How many lines from a shell's fronts, and from its backs, reach a lamp that is no part of it.
    fn lamps_seen(&self, shell: &Shell) -> [usize; 2] {
        let own = self.shell_of[shell.triangles[0] as usize];
        let others: Vec<usize> = self.lamps.iter().copied().filter(|&l| self.shell_of[l] != own).collect();
        let mut seen = [0; 2];
        for &t in spread(&shell.triangles) {
            let t = t as usize;
            let normal = self.scene.area_vector(t);
            for &lamp in spread(&others) {
                for (from, to) in self.scene.points_on(t).into_iter().zip(self.scene.points_on(lamp)) {
                    let height = (to - from).dot(normal);
                    if height != 0.0 && !self.rays.blocked(from, to, |i| i == t || i == lamp) {
                        seen[usize::from(height < 0.0)] += 1;
                    }
                }
            }
        }
        seen
    }

    /// What rays from the lamps of a shell meet, on the side of their fronts (1) or backs (-1).
    fn hits(&self, shell: &Shell, side: f64) -> Hits {
        let own = self.shell_of[shell.triangles[0] as usize];
        let lamps: Vec<usize> =
            shell.triangles.iter().map(|&t| t as usize).filter(|&t| self.scene.shines(t)).collect();
        let mut hits = Hits::default();
        for &lamp in spread(&lamps) {
            for (direction, point) in self.scene.rays_from(lamp, side) {
                if let Some((hit, _)) = self.rays.nearest(point, direction, Some(lamp)) {
                    hits.any += 1;
                    hits.other += usize::from(self.shell_of[hit] != own);
                }
            }
        }
        hits
    }
}

#[derive(Default)]
struct Hits {
    any: usize,
    /// Hits of other shells.
    other: usize,
}

/// Up to [`TRIED`] items, evenly spread.
pub(super) fn spread<T>(items: &[T]) -> impl Iterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(TRIED).max(1))
}

/// Directions of a hemisphere about +z, about as dense as the cosine.
const DIRECTIONS: [[f64; 3]; 9] = [
    [0.0, 0.0, 1.0],
    [0.5, 0.1, 0.860],
    [-0.1, 0.5, 0.860],
    [-0.5, -0.1, 0.860],
    [0.1, -0.5, 0.860],
    [0.6, 0.6, 0.529],
    [-0.6, 0.6, 0.529],
    [-0.6, -0.6, 0.529],
    [0.6, -0.6, 0.529],
];

impl Scene {
    /// Whether a triangle emits light.
    pub(super) fn shines(&self, triangle: usize) -> bool {
        self.material(triangle).emission.iter().any(|&e| e > 0.0)
    }

    /// The centroids of the four parts of a triangle.
    pub(super) fn points_on(&self, triangle: usize) -> [DVec3; 4] {
        let [a, b, c] = self.corners(triangle);
        let middle = (a + b + c) / 3.0;
        [middle, a.midpoint(middle), b.midpoint(middle), c.midpoint(middle)]
    }

    /// Rays from points on a triangle into the half space above its front (`side` 1) or behind it (-1): direction and origin.
    pub(super) fn rays_from(&self, triangle: usize, side: f64) -> impl Iterator<Item = (DVec3, DVec3)> {
        let normal = self.area_vector(triangle).normalize_or_zero() * side;
        let (u, v) = normal.try_normalize().unwrap_or(DVec3::Z).any_orthonormal_pair();
        let points = self.points_on(triangle);
        DIRECTIONS
            .into_iter()
            .zip(points.into_iter().cycle())
            .map(move |([x, y, z], point)| ((u * x + v * y + normal * z).normalize_or(normal), point))
    }
}
