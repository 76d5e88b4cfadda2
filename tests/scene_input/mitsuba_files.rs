//! Scenes of Mitsuba in several files, with groups and instances, of old versions, and what is in none of them.

use antirad::scene::Scene;
use glam::DVec3;

use super::mitsuba::{LAMP, area, good, load, scene};
use super::{Folder, assert_says};

/// The same scene in version 3, whose names are turned into those of version 0.
const NEW: &str = "<scene version=\"3.0.0\">\n\
    <default name=\"size\" value=\"3\"/>\n\
    <sensor type=\"perspective\"><float name=\"fov\" value=\"50\"/><string name=\"fov_axis\" value=\"y\"/>\n\
    <transform name=\"to_world\"><lookat origin=\"0,1.5,5\" target=\"0,1,0\" up=\"0,1,0\"/></transform>\n\
    <sampler type=\"independent\"><integer name=\"sample_count\" value=\"16\"/></sampler></sensor>\n\
    <bsdf type=\"diffuse\" id=\"wall\"><rgb name=\"reflectance\" value=\"0.6, 0.5, 0.4\"/></bsdf>\n\
    <bsdf type=\"plastic\" id=\"ball\"><rgb name=\"diffuse_reflectance\" value=\"0.2\"/><float name=\"int_ior\" value=\"1.4\"/></bsdf>\n\
    <shape type=\"rectangle\"><transform name=\"to_world\"><scale value=\"$size\"/><rotate x=\"1\" angle=\"-90\"/></transform><ref id=\"wall\"/></shape>\n\
    <shape type=\"sphere\"><transform name=\"to_world\"><translate y=\"1\"/></transform><ref id=\"ball\"/></shape>\n\
    <shape type=\"rectangle\"><boolean name=\"flip_normals\" value=\"true\"/><transform name=\"to_world\"><rotate x=\"1\" angle=\"-90\"/>\
    <translate y=\"2.5\"/></transform><emitter type=\"area\"><rgb name=\"radiance\" value=\"10\"/></emitter></shape>\n</scene>";

#[test]
fn old_names_mean_what_new_ones_do() {
    let mut old =
        NEW.replace("3.0.0", "0.5.0").replace("name=\"reflectance\"", "name=\"diffuseReflectance\"");
    for (new, camel) in [
        ("fov_axis", "fovAxis"),
        ("to_world", "toWorld"),
        ("lookat", "lookAt"),
        ("sample_count", "sampleCount"),
        ("diffuse_reflectance", "diffuseReflectance"),
        ("int_ior", "intIOR"),
        ("flip_normals", "flipNormals"),
    ] {
        assert!(old.contains(new), "{new}");
        old = old.replace(new, camel);
    }
    let [old, new] = [&old, NEW].map(|text| load(text).unwrap_or_else(|error| panic!("{error}")));
    assert_eq!(
        (&old.vertices, &old.triangles, &old.materials),
        (&new.vertices, &new.triangles, &new.materials)
    );
    assert_eq!(old.cameras, new.cameras);
    let said = |scene: &Scene| -> Vec<String> {
        scene.warnings.iter().map(|said| said.split("s.xml").last().unwrap_or_default().to_owned()).collect()
    };
    assert_eq!(said(&old), said(&new));
    assert_eq!(new.materials[0].albedo, [0.6, 0.5, 0.4]);
    assert!(new.cameras[0].fov_x_degrees > 50.0);
}

/// A name that nothing reads does not go unnoticed, and what makes no difference is not mentioned.
#[test]
fn what_nothing_reads_is_named() {
    let shape = |inner: &str| format!("{LAMP}<shape type=\"cube\">{inner}</shape>");
    for (text, part) in [
        (
            shape("<transform name=\"toWorld\"><scale value=\"2\"/></transform>"),
            "<transform name=\"toWorld\"> of <shape type=\"cube\">",
        ),
        (shape("<ref id=\"lost\"/>"), "<ref id=\"lost\"> of <shape type=\"cube\">"),
        (
            shape("<medium type=\"homogeneous\" name=\"interior\"/>"),
            "<medium type=\"homogeneous\" name=\"interior\"> of",
        ),
        (
            shape("<bsdf type=\"diffuse\"><rgb name=\"color\" value=\"1\"/></bsdf>"),
            "<rgb name=\"color\"> of <bsdf type=\"diffuse\">",
        ),
        (format!("{LAMP}<medium type=\"homogeneous\"/>"), "<medium type=\"homogeneous\">"),
    ] {
        let said = good(&text).warnings.join("\n");
        assert!(said.contains("ignored or approximated") && said.contains(part), "{part}: {said}");
    }
    let film = "<sensor type=\"perspective\"><float name=\"near_clip\" value=\"0.1\"/><sampler type=\"independent\"/><film type=\"hdrfilm\">\
                <string name=\"pixel_format\" value=\"rgb\"/><rfilter type=\"gaussian\"/></film></sensor><integrator type=\"path\"/>";
    let said = good(&format!("{LAMP}<shape type=\"cube\"/>{film}")).warnings.join("\n");
    assert!(!said.contains("ignored"), "{said}");
}

fn in_files(files: &[(&str, &str)]) -> Result<Scene, String> {
    let folder = Folder::with(&[]);
    std::fs::create_dir(folder.0.path().join("parts")).expect("a folder");
    for (name, text) in files {
        std::fs::write(folder.0.path().join(name), text).expect("written");
    }
    folder.load("s.xml", false).map_err(|error| error.to_string())
}

#[test]
fn includes_stand_where_they_are_named() {
    let main = scene(&format!(
        "{LAMP}<default name=\"high\" value=\"3\"/><include filename=\"parts\\walls.xml\"/><shape type=\"disk\"><ref id=\"paint\"/></shape>"
    ));
    // Of another version, with a default of its own that the main file overrides, and a mesh beside it.
    let walls = "<scene version=\"0.6.0\"><default name=\"high\" value=\"9\"/><default name=\"grey\" value=\"0.25\"/>\n\
                 <bsdf type=\"diffuse\" id=\"paint\"><rgb name=\"reflectance\" value=\"$grey\"/></bsdf>\n\
                 <shape type=\"obj\" id=\"wall\"><string name=\"filename\" value=\"a.obj\"/><transform name=\"toWorld\">\
                 <translate y=\"$high\"/></transform></shape></scene>";
    let mesh = "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 3 2\n";
    let files = [("s.xml", main.as_str()), ("parts/walls.xml", walls), ("parts/a.obj", mesh)];
    let read = in_files(&files).unwrap_or_else(|error| panic!("{error}"));
    let names: Vec<&str> = read.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    assert_eq!(names, ["lamp", "wall", "disk"]);
    assert_eq!(read.corners(read.meshes[1].range.start as usize)[0], DVec3::new(0.0, 3.0, 0.0));
    assert_eq!(read.material(read.meshes[2].range.start as usize).albedo, [0.25; 3]);
    for (walls, parts) in [
        (
            "<scene version=\"3.0.0\"><include filename=\"walls.xml\"/></scene>",
            vec!["walls.xml:1", "included by itself"],
        ),
        (
            "<scene version=\"3.0.0\">\n<include filename=\"lost.xml\"/></scene>",
            vec!["walls.xml:2", "lost.xml cannot be read"],
        ),
        ("<scene version=\"3.0.0\">\n<include/></scene>", vec!["walls.xml:2", "no filename"]),
        ("<scene version=\"3.0.0\">\n<shape type=\"obj\"/></scene>", vec!["walls.xml:2", "filename"]),
        ("<shape type=\"cube\"/>", vec!["walls.xml:1", "expected <scene>"]),
    ] {
        let error = in_files(&[("s.xml", &main), ("parts/walls.xml", walls), ("parts/a.obj", mesh)]);
        assert_says(&error.expect_err(parts[1]), &parts);
    }
}

#[test]
fn instances_place_their_groups() {
    let group = "<bsdf type=\"diffuse\" id=\"red\"><rgb name=\"reflectance\" value=\"0.5, 0, 0\"/></bsdf>\
                 <shape type=\"shapegroup\" id=\"pair\"><shape type=\"rectangle\"><ref id=\"red\"/></shape>\
                 <shape type=\"ply\"><string name=\"filename\" value=\"a.ply\"/><transform name=\"to_world\"><translate x=\"5\"/></transform>\
                 </shape></shape>";
    let instance = |steps: &str| {
        format!(
            "<shape type=\"instance\"><ref id=\"pair\"/><transform name=\"to_world\">{steps}</transform></shape>"
        )
    };
    let text = format!(
        "{LAMP}{group}{}{}",
        instance("<scale value=\"2\"/><translate z=\"1\"/>"),
        instance("<scale x=\"-1\"/>")
    );
    let read = good(&text);
    let names: Vec<&str> = read.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    assert_eq!(names, ["lamp", "rectangle", "ply", "rectangle_2", "ply_2"]);
    for (mesh, vector) in [(1, 16.0), (2, 2.0), (3, 4.0), (4, 0.5)] {
        let (found, _) = area(&read, mesh);
        assert!(
            found.abs_diff_eq(vector * DVec3::Z, 1e-9),
            "fronts stay fronts where they are mirrored: {found}"
        );
    }
    let corner = |mesh: usize| read.corners(read.meshes[mesh].range.start as usize)[0];
    assert_eq!((corner(2), corner(4)), (DVec3::new(10.0, 0.0, 1.0), DVec3::new(-5.0, 0.0, 0.0)));
    let red = |mesh: usize| read.triangles[read.meshes[mesh].range.start as usize].material;
    assert_eq!(red(1), red(3));
    assert_eq!(read.material(read.meshes[1].range.start as usize).albedo, [0.5, 0.0, 0.0]);
    // A group alone stands nowhere.
    assert_eq!(good(&format!("{LAMP}{group}")).meshes.len(), 1);
    let lost = load(&scene("<shape type=\"instance\"><ref id=\"none\"/></shape>")).expect_err("no group");
    assert_says(&lost, &["s.xml:2", "shapegroup"]);
}
