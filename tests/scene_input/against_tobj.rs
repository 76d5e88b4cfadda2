//! The readers of OBJ and MTL compared with the crate `tobj`: they agree on plain files, and the second test lists the reasons
//! not to use `tobj` instead. If one of its cases fails with a newer version, that reason is gone.

use std::path::Path;

use antirad::scene::{LoadOptions, Scene};
use glam::DVec3;
use tobj::LoadError;

use super::{load, names};

type Loaded = Result<(Vec<tobj::Model>, Result<Vec<tobj::Material>, LoadError>), LoadError>;

/// The result of `tobj` for a text and the one material file that it may name, with panics as errors.
fn tobj_reads(obj: &str, mtl: &str) -> Result<Loaded, ()> {
    let options = tobj::LoadOptions::default();
    let read =
        || tobj::load_obj_buf(&mut obj.as_bytes(), &options, |_| tobj::load_mtl_buf(&mut mtl.as_bytes()));
    std::panic::catch_unwind(read).map_err(|_| ())
}

#[test]
fn plain_files_are_read_alike() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut triangles = 0;
    for folder in [root.join("scenes"), root.join("tests/data")] {
        for name in names(&folder).into_iter().filter(|name| name.ends_with(".obj")) {
            let path = folder.join(name);
            let scene = Scene::load(&path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
            let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
            let (models, materials) = tobj::load_obj(&path, &options).expect("a mesh");
            let materials = materials.expect("materials");
            let mut next = 0;
            for tobj::Model { mesh, .. } in models {
                let vertex = |v: &u32| DVec3::from_slice(&mesh.positions[3 * *v as usize..]);
                for corners in mesh.indices.chunks_exact(3) {
                    assert_eq!(
                        scene.corners(next).as_slice(),
                        corners.iter().map(vertex).collect::<Vec<_>>()
                    );
                    let (ours, other) =
                        (scene.material(next), &materials[mesh.material_id.expect("a material")]);
                    assert_eq!(ours.name, other.name);
                    assert_eq!(ours.albedo, other.diffuse.unwrap_or_default());
                    assert_eq!(ours.specular, other.specular.unwrap_or_default());
                    assert_eq!(ours.emission, other.emissive.unwrap_or_default());
                    assert_eq!(ours.power, other.shininess.unwrap_or_default());
                    next += 1;
                }
            }
            assert_eq!(next, scene.triangles.len(), "{}", path.display());
            triangles += next;
        }
    }
    assert!(triangles > 5000, "{triangles}");
}

#[test]
fn what_keeps_tobj_from_reading_for_us() {
    let quad = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let obj = |more: &str| format!("{quad}{more}\n");

    // Valid files that it rejects: comments and continued lines (`meshes::obj_forms`), some vertices with colours and
    // some without (fuzz/corpus/obj/forms.obj).
    for more in ["f 1 2 3 # one", "f 1 2 \\\n 3", "v 0 0 1 .5 .5 .5\nf 1 2 3"] {
        assert!(matches!(tobj_reads(&obj(more), ""), Ok(Err(_))), "{more}");
        assert!(load("m.obj", &[("m.obj", &obj(more))]).is_ok(), "{more}");
    }
    // Materials at which it panics: one number for grey, which the format allows (fuzz/corpus/mtl/all.mtl), and two
    // (`meshes::broken_mtl_lines`). So do indices of textures below 1, which we do not read.
    for mtl in ["newmtl a\nKd .3", "newmtl a\nKd .3 .3"] {
        assert!(tobj_reads("mtllib m.mtl", mtl).is_err(), "{mtl}");
    }
    assert!(
        load("m.obj", &[("m.mtl", "newmtl white\nKd .3\nnewmtl lamp\nKe 1"), ("m.obj", super::OBJ)]).is_ok()
    );
    // Mistakes that it ignores: `meshes::broken_obj_lines` requires an error with the line of each.
    for more in ["v 0 nan 0", "v 0 0 1e999", "f 1 2 5\nv 0 0 1", "f 1 2"] {
        assert!(matches!(tobj_reads(&obj(more), "newmtl a"), Ok(Ok(_))), "{more}");
        assert!(load("m.obj", &[("m.obj", &obj(more))]).is_err(), "{more}");
    }
    for mtl in ["Kd 1 1 1\nnewmtl a", "newmtl a\nnewmtl a", "newmtl a\nKd nan 1 1"] {
        assert!(matches!(tobj_reads("mtllib m.mtl", mtl), Ok(Ok((_, Ok(_))))), "{mtl}");
        assert!(load("s.toml", &[("m.mtl", mtl)]).is_err(), "{mtl}");
    }
    // The name of a material that the scene file defines is lost (`meshes::faces_without_material_are_grey`), and so is
    // one of an MTL file that is named after its faces.
    for text in [obj("usemtl wood\nf 1 2 3"), obj("usemtl white\nf 1 2 3\nmtllib m.mtl")] {
        let Ok(Ok((models, _))) = tobj_reads(&text, super::MTL) else { panic!("{text}") };
        assert!(models.iter().all(|model| model.mesh.material_id.is_none()), "{text}");
    }
    // Vertices are renumbered, and those shared by two materials duplicated, but fits and gradients identify vertices
    // by their number in the file (`the_good_files_load_without_a_warning` has four).
    let Ok(Ok((models, _))) = tobj_reads(super::OBJ, super::MTL) else { panic!("the good file") };
    assert_eq!(models.iter().map(|model| model.mesh.positions.len() / 3).sum::<usize>(), 6);
}
