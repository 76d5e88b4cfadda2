//! Mesh files with more triangles than light needs are simplified, once they are snapped and turned.

use std::collections::HashMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::super::geometry::RawMesh;
use super::super::given::GivenMeshes;
use super::super::simplify::{Corner, apart, simplified};
use super::super::{Scene, Triangle};
use super::Assembly;

/// Most triangles of a scan, unless `simplify` states another number.
const OF_SCANS: u32 = 10_000;

/// How many triangles a mesh file may have at most; `None` for any number.
#[derive(Clone, Copy)]
pub(in super::super) struct Most(pub Option<u32>);

impl Most {
    /// By what is stated, where 0 is any number, and whether the mesh is snapped, as scans are.
    pub fn new(stated: Option<u32>, snapped: bool) -> Self {
        Self(stated.or(snapped.then_some(OF_SCANS)).filter(|&most| most > 0))
    }
}

/// All meshes of a file that is simplified.
pub(super) struct Whole {
    pub file: PathBuf,
    pub most: u32,
    /// Its meshes, triangles and vertices in the scene.
    pub meshes: Range<usize>,
    pub triangles: Range<usize>,
    pub vertices: Range<u32>,
    /// As read, and its materials in the scene.
    pub raw: RawMesh,
    pub materials: Vec<u32>,
}

/// What is left of a file: its triangles, mesh by mesh.
struct Left {
    raw: RawMesh,
    /// Per mesh, how many.
    counts: Vec<usize>,
    materials: Vec<u32>,
}

impl Assembly {
    /// Simplifies the files that have too many triangles, and keeps their meshes as given.
    ///
    /// Returns whether there are any.
    pub(super) fn simplify_files(&mut self) -> bool {
        let wholes = std::mem::take(&mut self.wholes);
        if wholes.is_empty() {
            return false;
        }
        let mut given = GivenMeshes::default();
        let mut left = Vec::new();
        for whole in &wholes {
            let meshes = &self.scene.meshes[whole.meshes.clone()];
            let of = whole.left(&self.scene);
            let first = given.vertices.len() as u32;
            given.vertices.extend_from_slice(&whole.raw.vertices);
            for mesh in meshes {
                let faces = mesh.range.clone().map(|t| {
                    self.scene.triangles[t as usize].vertices.map(|v| first + v - whole.vertices.start)
                });
                given.meshes.insert(mesh.name.clone(), faces.collect());
            }
            self.simplified.resize(self.scene.meshes.len(), false);
            self.simplified[whole.meshes.clone()].fill(true);
            left.push(of);
        }
        self.scene.given = Some(Arc::new(given));
        self.replace(&wholes, left);
        for whole in &wholes {
            let note = self.note(whole);
            self.scene.warnings.push(note);
        }
        self.scene.leave_out_vertices(|v| wholes.iter().any(|whole| whole.vertices.contains(&v)));
        self.scene.update_degenerate();
        true
    }

    /// Puts what is left of files in place of their triangles.
    fn replace(&mut self, wholes: &[Whole], left: Vec<Left>) {
        let old = std::mem::take(&mut self.scene.triangles);
        let mut rows: Vec<u32> = Vec::new();
        let mut new = Vec::new();
        let mut parts = wholes.iter().zip(left).peekable();
        let mut k = 0;
        while k < self.scene.meshes.len() {
            match parts.next_if(|(whole, _)| whole.meshes.start == k) {
                None => {
                    let range = self.scene.meshes[k].range.clone();
                    self.scene.meshes[k].range = rows.len() as u32..(rows.len() + range.len()) as u32;
                    self.scene.triangles.extend_from_slice(&old[range.start as usize..range.end as usize]);
                    rows.extend(range);
                    k += 1;
                }
                Some((whole, Left { raw, counts, materials })) => {
                    let (of_faces, patterns) = self.face_materials(&raw, &materials);
                    let mut first = rows.len();
                    new.push((first, patterns, raw.uvs));
                    for (count, mesh) in counts.into_iter().zip(whole.meshes.clone()) {
                        self.scene.meshes[mesh].range = first as u32..(first + count) as u32;
                        let from = first - rows.len();
                        self.scene.origins[mesh].lines =
                            raw.face_lines.get(from..from + count).unwrap_or_default().to_vec();
                        first += count;
                    }
                    let triangle =
                        |(&vertices, &material): (&[u32; 3], &u32)| Triangle { vertices, material };
                    self.scene.triangles.extend(raw.faces.iter().zip(&of_faces).map(triangle));
                    rows.extend(raw.faces.iter().map(|_| u32::MAX));
                    k = whole.meshes.end;
                }
            }
        }
        let patterns = Arc::make_mut(&mut self.scene.patterns);
        patterns.rearrange(rows.iter().map(|&old| (old, DVec3::AXES)));
        for (first, of, uvs) in new {
            patterns.put(first, of);
            (first..).zip(uvs).for_each(|(t, uvs)| patterns.set_uvs(t, uvs));
        }
    }

    fn note(&self, whole: &Whole) -> String {
        let scene = &self.scene;
        let ranges = scene.meshes[whole.meshes.clone()].iter().flat_map(|mesh| mesh.range.clone());
        let surface: Vec<[DVec3; 3]> = ranges.map(|t| scene.corners(t as usize)).collect();
        let faces = &whole.raw.faces;
        let given: Vec<_> = faces.iter().map(|face| face.map(|v| whole.raw.vertices[v as usize])).collect();
        let count = surface.len();
        let [mean, farthest] = apart(&given, surface).map(|metres| 1e3 * metres);
        let short = match count > whole.most as usize {
            true => "; more would break borders of its objects, materials or texture coordinates",
            false => "",
        };
        format!(
            "{}: light is computed on {count} of its {} triangles (simplify = {}), whose surface is {mean:.3} mm off (rms, {farthest:.3} mm \
             at most){short}. `simplify = 0` keeps all.",
            whole.file.display(),
            faces.len(),
            whole.most
        )
    }
}

impl Whole {
    fn left(&self, scene: &Scene) -> Left {
        let raw = &self.raw;
        // The corner of the file's face that is at a corner of the scene's triangle, which may be turned.
        let in_file = |t: usize, k: usize| {
            let turned = scene.triangles[self.triangles.start + t].vertices[1]
                != raw.faces[t][1] + self.vertices.start;
            if turned { (3 - k) % 3 } else { k }
        };
        let uv = |t: usize, k: usize| raw.uvs.get(t).map_or(DVec2::NAN, |uvs| uvs[in_file(t, k)]);
        let colour = |t: usize, k: usize| raw.colours.get(t).map_or(DVec3::ONE, |of| of[in_file(t, k)]);
        let vertex = |t: usize, k: usize| scene.triangles[self.triangles.start + t].vertices[k];
        let corner = |t: usize, k: usize| Corner {
            place: scene.vertices[vertex(t, k) as usize],
            uv: uv(t, k),
            colour: colour(t, k),
        };
        let triangles: Vec<[Corner; 3]> =
            (0..raw.faces.len()).map(|t| [0, 1, 2].map(|k| corner(t, k))).collect();
        let mut mesh_of = vec![0; raw.faces.len()];
        for (k, mesh) in (0..).zip(&scene.meshes[self.meshes.clone()]) {
            let range = mesh.range.start as usize - self.triangles.start
                ..mesh.range.end as usize - self.triangles.start;
            mesh_of[range].fill(k);
        }
        let mut known = HashMap::new();
        let mut region = |(&mesh, &material): (&u32, &u32)| {
            let new = known.len() as u32;
            *known.entry((mesh, material)).or_insert(new)
        };
        let regions: Vec<u32> = mesh_of.iter().zip(&raw.face_materials).map(&mut region).collect();
        let mut faces = simplified(&triangles, &regions, self.most as usize);
        // A mesh that would vanish stays.
        let mut stays = vec![false; self.meshes.len()];
        faces.iter().for_each(|face| stays[mesh_of[face[0].0 as usize] as usize] = true);
        let lost = (0..raw.faces.len() as u32).filter(|&t| !stays[mesh_of[t as usize] as usize]);
        faces.extend(lost.map(|t| [0, 1, 2].map(|k| (t, k))));
        faces.sort_by_key(|face| mesh_of[face[0].0 as usize]);
        let each = |face: &[(u32, usize); 3]| face.map(|(t, k)| (t as usize, k));
        let first = |face: &[(u32, usize); 3]| face[0].0 as usize;
        let has = |count: usize| count == raw.faces.len();
        let own = RawMesh {
            faces: faces.iter().map(|face| each(face).map(|(t, k)| vertex(t, k))).collect(),
            face_materials: faces.iter().map(|face| raw.face_materials[first(face)]).collect(),
            face_lines: match has(raw.face_lines.len()) {
                true => faces.iter().map(|face| raw.face_lines[first(face)]).collect(),
                false => Vec::new(),
            },
            uvs: match has(raw.uvs.len()) {
                true => faces.iter().map(|face| each(face).map(|(t, k)| uv(t, k))).collect(),
                false => Vec::new(),
            },
            colours: match has(raw.colours.len()) {
                true => faces.iter().map(|face| each(face).map(|(t, k)| colour(t, k))).collect(),
                false => Vec::new(),
            },
            ..RawMesh::empty()
        };
        let mut counts = vec![0; self.meshes.len()];
        faces.iter().for_each(|face| counts[mesh_of[first(face)] as usize] += 1);
        Left { raw: own, counts, materials: self.materials.clone() }
    }
}
