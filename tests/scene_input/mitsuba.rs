//! Scenes of Mitsuba 3.

use antirad::scene::Scene;
use glam::DVec3;

use super::{Folder, OBJ, assert_says};

pub fn load(xml: &str) -> Result<Scene, String> {
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list \
               uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let wall = "# nm, share\n400 0.343\n500\t.3\n\n600 .5\n700 .64 # red\n";
    let folder = Folder::with(&[
        ("s.xml", xml),
        ("a.ply", ply),
        ("a.obj", &OBJ.replace("m.mtl", "lost.mtl")),
        ("wall.spd", wall),
    ]);
    // Half of it black, half white.
    let picture = image::GrayImage::from_fn(4, 2, |x, _| image::Luma([if x < 2 { 0 } else { 255 }]));
    picture.save(folder.0.path().join("half.png")).expect("a picture");
    folder.load("s.xml", false).map_err(|error| error.to_string())
}

pub fn scene(inner: &str) -> String {
    format!("<scene version=\"3.0.0\">\n{inner}\n</scene>\n")
}

pub fn good(inner: &str) -> Scene {
    load(&scene(inner)).unwrap_or_else(|error| panic!("{error}"))
}

/// Sum of area vectors and of areas of a mesh.
pub fn area(scene: &Scene, mesh: usize) -> (DVec3, f64) {
    let range = scene.meshes[mesh].range.clone();
    let vectors = range.map(|t| scene.area_vector(t as usize));
    vectors.fold((DVec3::ZERO, 0.0), |(sum, all), vector| (sum + vector, all + vector.length()))
}

pub const LAMP: &str = "<shape type=\"rectangle\" id=\"lamp\"><emitter type=\"area\"><rgb name=\"radiance\" value=\"18, 12, 4\"/></emitter>\
                    <transform name=\"to_world\"><rotate x=\"1\" angle=\"90\"/><scale value=\"0.5\"/><translate y=\"2\"/></transform></shape>";

/// Few faces, whose light can be exact, and the power of the sphere; a dome stays round.
#[test]
fn spheres_that_shine_have_few_faces() {
    let bulb = |more: &str| {
        format!(
            "<shape type=\"sphere\"><float name=\"radius\" value=\"0.5\"/><emitter type=\"area\"><rgb name=\"radiance\" \
             value=\"3\"/></emitter>{more}</shape><shape type=\"disk\"/>"
        )
    };
    let scene = good(&bulb(""));
    assert_eq!(scene.meshes[0].range.len(), 20);
    assert!((area(&scene, 0).1 / std::f64::consts::PI - 1.0).abs() < 1e-12);
    let dome = good(&bulb("<boolean name=\"flip_normals\" value=\"true\"/>"));
    assert_eq!(dome.meshes[0].range.len(), 1280);
}

#[test]
fn shapes_stand_where_they_should() {
    let text = format!(
        "{LAMP}<shape type=\"cube\"/><shape type=\"sphere\"><float name=\"radius\" value=\"2\"/><point name=\"center\" x=\"5\" y=\"0\" \
         z=\"0\"/></shape><shape type=\"disk\"/><shape type=\"ply\"><string name=\"filename\" value=\"a.ply\"/></shape><shape \
         type=\"obj\"><string name=\"filename\" value=\"a.obj\"/><boolean name=\"flip_normals\" value=\"true\"/></shape>"
    );
    let scene = good(&text);
    let names: Vec<&str> = scene.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    assert_eq!(names, ["lamp", "cube", "sphere", "disk", "ply", "obj"]);
    // The square of side 2 at z = 0 that faces +z, turned to face -y, halved, and moved.
    let (vector, whole) = area(&scene, 0);
    assert!(vector.abs_diff_eq(DVec3::NEG_Y, 1e-12) && (whole - 1.0).abs() < 1e-12, "{vector}");
    assert!(scene.corners(0).iter().all(|corner| (corner.y - 2.0).abs() < 1e-12));
    assert_eq!(scene.material(0).emission, [18.0, 12.0, 4.0]);
    assert!((area(&scene, 1).1 - 24.0).abs() < 1e-9);
    assert!((area(&scene, 2).1 / (16.0 * std::f64::consts::PI) - 1.0).abs() < 0.01);
    let (disk, _) = area(&scene, 3);
    assert!((disk.z / std::f64::consts::PI - 1.0).abs() < 0.01);
    assert!(area(&scene, 4).0.abs_diff_eq(0.5 * DVec3::Z, 1e-12));
    assert!(area(&scene, 5).0.abs_diff_eq(DVec3::new(-0.5, 0.0, -0.5), 1e-12), "flipped");
    for mesh in [1, 2] {
        let triangle = scene.meshes[mesh].range.start as usize;
        let centre = if mesh == 1 { DVec3::ZERO } else { DVec3::new(5.0, 0.0, 0.0) };
        assert!(scene.area_vector(triangle).dot(scene.corners(triangle)[0] - centre) > 0.0, "fronts outside");
    }
}

#[test]
fn materials_and_what_stands_in_for_them() {
    let wall = |bsdf: &str| {
        let scene = good(&format!(
            "{LAMP}<default name=\"grey\" value=\"0.25\"/>{bsdf}<shape type=\"rectangle\"><ref id=\"b\"/></shape>"
        ));
        let index = scene.meshes[1].range.start as usize;
        (scene.material(index).clone(), scene.meshes[1].range.len(), scene.warnings.join("\n"))
    };
    let (diffuse, sides, _) =
        wall("<bsdf type=\"diffuse\" id=\"b\"><rgb name=\"reflectance\" value=\"$grey 0.5 0.75\"/></bsdf>");
    assert_eq!((diffuse.name.as_str(), diffuse.albedo, sides), ("b", [0.25, 0.5, 0.75], 128));
    let (_, sides, _) = wall("<bsdf type=\"twosided\" id=\"b\"><bsdf type=\"diffuse\"/></bsdf>");
    assert_eq!(sides, 256);
    let (plastic, _, said) =
        wall("<bsdf type=\"roughplastic\" id=\"b\"><float name=\"alpha\" value=\"0.2\"/></bsdf>");
    assert!(
        (plastic.power - 48.0).abs() < 1e-9 && plastic.specular == [0.04; 3] && plastic.albedo == [0.5; 3]
    );
    assert!(said.contains("roughplastic"), "{said}");
    let (glass, _, said) = wall("<bsdf type=\"dielectric\" id=\"b\"/>");
    assert!(glass.albedo == [0.5; 3] && said.contains("<bsdf type=\"dielectric\">"), "{said}");
    let (mirror, _, said) = wall("<bsdf type=\"conductor\" id=\"b\"/>");
    assert!(mirror.power == 2000.0 && said.contains("smooth surfaces, as lobes of power 2000"), "{said}");
    let (checks, _, said) =
        wall("<bsdf type=\"diffuse\" id=\"b\"><texture name=\"reflectance\" type=\"checkerboard\"/></bsdf>");
    assert!(
        checks.albedo == [0.5; 3] && said.contains("<texture type=\"checkerboard\">, grey 0.5"),
        "{said}"
    );
    let said = good(&format!("{LAMP}<emitter type=\"sunsky\"/><shape type=\"hair\"/>")).warnings.join("");
    for ignored in ["<emitter type=\"sunsky\">, for which [sun] and [sky]", "<shape type=\"hair\">"] {
        assert!(said.contains(ignored), "{said}");
    }
}

/// In their colours, as Mitsuba's RGB variants show them (its `cbox.xml` of old is written like this).
#[test]
fn spectra_are_colours() {
    let lit = |reflectance: &str, radiance: &str| {
        good(&format!(
            "<shape type=\"rectangle\"><bsdf type=\"diffuse\"><spectrum name=\"reflectance\" {reflectance}/></bsdf></shape>\
             <shape type=\"disk\"><emitter type=\"area\"><spectrum name=\"radiance\" {radiance}/></emitter></shape>"
        ))
    };
    let lamp = "value=\"400:0, 500:8, 600:15.6, 700:18.4\"";
    for wall in ["value=\"400:0.343 500:.3,600:.5\n700:.64\"", "filename=\"wall.spd\""] {
        let scene = lit(wall, lamp);
        assert!(scene.warnings.iter().all(|said| !said.contains("ignored")), "{:?}", scene.warnings);
        let colours = [scene.materials[0].albedo, scene.materials[1].emission];
        for (found, mitsuba) in
            colours.iter().zip([[0.57635, 0.377433, 0.306476], [20.7108, 10.8546, 2.77115]])
        {
            let near = |c: usize| (found[c] - mitsuba[c]).abs() < 0.02 * mitsuba[0];
            assert!((0..3).all(near), "{found:?}, not {mitsuba:?}");
        }
    }
    // The same at all wavelengths is grey as a reflectance, but not as a light.
    let scene = lit("value=\"0.3\"", "value=\"3\"");
    assert!((0..3).all(|c| (scene.materials[0].albedo[c] - 0.3).abs() < 1e-6));
    assert!((scene.materials[1].emission[0] - 3.61438).abs() < 0.02, "{:?}", scene.materials[1].emission);
}

#[test]
fn sensors_look_where_they_should() {
    let sensor = |inner: &str| {
        let text = format!(
            "{LAMP}<sensor type=\"perspective\" id=\"eye\"><float name=\"fov\" value=\"40\"/>{inner}<transform name=\"to_world\"><lookat \
             origin=\"1, 2, 9\" target=\"1, 2, 0\" up=\"0, 1, 0\"/></transform></sensor>"
        );
        good(&text).cameras[0].clone()
    };
    let film = "<film type=\"hdrfilm\"><integer name=\"width\" value=\"200\"/><integer name=\"height\" value=\"100\"/></film>";
    let eye = sensor(film);
    assert_eq!((eye.name.as_str(), eye.width, eye.height), ("eye", 200, 100));
    assert!(eye.position.abs_diff_eq(DVec3::new(1.0, 2.0, 9.0), 1e-12));
    assert!(
        (eye.target - eye.position).abs_diff_eq(DVec3::NEG_Z, 1e-12) && eye.up.abs_diff_eq(DVec3::Y, 1e-12)
    );
    assert!((eye.fov_x_degrees - 40.0).abs() < 1e-9);
    let tangent = |degrees: f64| (degrees / 2.0).to_radians().tan();
    for axis in ["y", "smaller"] {
        let high = sensor(&format!("{film}<string name=\"fov_axis\" value=\"{axis}\"/>"));
        assert!((tangent(high.fov_x_degrees) - 2.0 * tangent(40.0)).abs() < 1e-9);
    }
}

#[test]
fn what_is_wrong_is_said() {
    for (text, parts) in [
        ("".to_owned(), vec!["s.xml:1", "no XML"]),
        ("<scene>\n<shape>".to_owned(), vec!["s.xml:", "no XML"]),
        ("<thing/>".to_owned(), vec!["s.xml:1", "expected <scene>"]),
        (scene("<shape type=\"obj\"/>"), vec!["s.xml:2", "filename"]),
        (
            scene("<shape type=\"ply\"><string name=\"filename\" value=\"lost.ply\"/></shape>"),
            vec!["s.xml:2", "lost.ply", "cannot be read"],
        ),
        (
            scene("<shape type=\"obj\"><string name=\"filename\" value=\"s.xml\"/></shape>"),
            vec!["no triangles"],
        ),
        (
            scene("<shape type=\"sphere\"><float name=\"radius\" value=\"$r\"/></shape>"),
            vec!["s.xml:2", "$r", "no <default>"],
        ),
        (
            scene("<shape type=\"sphere\"><float name=\"radius\" value=\"nan\"/></shape>"),
            vec!["s.xml:2", "no finite number"],
        ),
        (
            scene(
                "<shape type=\"cube\"><transform name=\"to_world\"><rotate angle=\"4\"/></transform></shape>",
            ),
            vec!["s.xml:2", "axis"],
        ),
        (
            scene(
                "<shape type=\"cube\"><transform name=\"to_world\"><matrix value=\"1 2\"/></transform></shape>",
            ),
            vec!["16 or 9"],
        ),
        (
            scene(
                "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf><shape type=\"cube\"><ref id=\"a\"/></shape>",
            ),
            vec!["has no BSDF"],
        ),
        (
            scene(
                "<shape type=\"disk\"><emitter type=\"area\"><spectrum name=\"radiance\" value=\"500:1, 400:1\"/></emitter></shape>",
            ),
            vec!["s.xml:2", "400 follows 500"],
        ),
        (
            scene(
                "<shape type=\"disk\"><emitter type=\"area\"><spectrum name=\"radiance\" value=\"500:1, 600\"/></emitter></shape>",
            ),
            vec!["s.xml:2", "`600` is no `wavelength:value`"],
        ),
        (
            scene(
                "<shape type=\"disk\"><emitter type=\"area\"><spectrum name=\"radiance\" filename=\"lost.spd\"/></emitter></shape>",
            ),
            vec!["s.xml:2", "lost.spd cannot be read"],
        ),
        (scene(""), vec!["s.xml", "no triangles"]),
    ] {
        assert_says(&load(&text).expect_err(parts[0]), &parts);
    }
}
