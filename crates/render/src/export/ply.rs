//! Binary PLY.

use antirad_base::output::{OutputError, atomic_write};
use antirad_scene::Scene;
use std::collections::HashMap;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes the scene as one mesh whose faces have linear colours: their light, or else their albedo.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_scene(scene: &Scene, path: &Path, light: Option<&[[f64; 3]]>) -> Result<(), OutputError> {
    let colour = |t: usize| light.map_or_else(|| scene.material(t).diffuse_albedo(), |light| light[t]);
    let triangles: Vec<usize> = (0..scene.triangles.len()).collect();
    write(scene, path, &triangles, Some(&colour))
}

/// Writes some triangles of a scene, with the vertices that they use.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(
    scene: &Scene,
    path: &Path,
    triangles: &[usize],
    colour: Option<&dyn Fn(usize) -> [f64; 3]>,
) -> Result<(), OutputError> {
    let mut numbers = HashMap::new();
    let mut used = Vec::new();
    for &t in triangles {
        for v in scene.triangles[t].vertices {
            numbers.entry(v).or_insert_with(|| {
                used.push(v);
                used.len() as u32 - 1
            });
        }
    }
    atomic_write(path, |file| {
        let mut file = BufWriter::new(file);
        header(&mut file, used.len(), triangles.len(), colour.is_some())?;
        for &v in &used {
            for x in scene.vertices[v as usize].to_array() {
                file.write_all(&x.to_le_bytes())?;
            }
        }
        for &t in triangles {
            file.write_all(&[3])?;
            for v in scene.triangles[t].vertices {
                file.write_all(&numbers[&v].to_le_bytes())?;
            }
            for x in colour.iter().flat_map(|colour| colour(t)) {
                file.write_all(&(x as f32).to_le_bytes())?;
            }
        }
        file.flush()
    })
}

fn header(file: &mut impl Write, vertices: usize, faces: usize, coloured: bool) -> io::Result<()> {
    writeln!(file, "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}")?;
    for axis in ["x", "y", "z"] {
        writeln!(file, "property double {axis}")?;
    }
    writeln!(file, "element face {faces}\nproperty list uchar uint vertex_indices")?;
    for channel in ["red", "green", "blue"].iter().filter(|_| coloured) {
        writeln!(file, "property float {channel}")?;
    }
    writeln!(file, "end_header")
}
