//! Lamps by name: other factors of their emission give the scene in another light.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io::{Error, Write};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;

use super::check::check_light;
use super::error::{nearest, quoted};
use super::material::numbered;
use super::{Material, Mesh, Scene, SceneError, TomlFile, Triple};
use antirad_base::output::{OutputError, atomic_write};

/// Emitting materials of one mesh from which on they count as one lamp: an emission for each triangle is not a lamp for each.
const MANY: usize = 16;

/// A factor for the light of what has a name.
#[derive(Clone, Debug, PartialEq)]
pub struct LampFactor {
    /// Name of a mesh or of a material that emits; `sun`, `sun.2` and so on for suns.
    pub name: String,
    /// Factor of its emission, RGB; 0 switches it off.
    pub factor: [f64; 3],
    /// The file and the line that state it, for errors.
    pub origin: Option<(PathBuf, usize)>,
}

/// What a name stands for.
enum Named {
    /// Triangles that emit, ascending.
    Triangles(Vec<u32>),
    /// A place in [`Scene::suns`].
    Sun(usize),
}

impl LampFactor {
    /// A factor that no file states.
    pub fn new(name: impl Into<String>, factor: [f64; 3]) -> Self {
        Self { name: name.into(), factor, origin: None }
    }

    /// Reads factors from a TOML file of `"NAME" = FACTOR`, with one number or RGB, as [`Scene::save_lamps`] writes it.
    ///
    /// # Errors
    /// Fails if the file cannot be read, is no such table, or has a factor that is negative or not finite.
    pub fn read(path: &Path) -> Result<Vec<Self>, SceneError> {
        #[derive(Deserialize)]
        #[serde(transparent)]
        struct Table(BTreeMap<String, Spanned<Triple>>);

        let file = TomlFile::read(path)?;
        let Table(table) = file.parse()?;
        let read = |(name, factor): (String, Spanned<Triple>)| {
            let place = file.place(factor.span());
            let factor = factor.get_ref().0;
            let origin = Some((path.to_path_buf(), place.line));
            match check_factor(factor) {
                Ok(()) => Ok(Self { name, factor, origin }),
                Err(message) => Err(place.error(format!("the factor of \"{name}\" is {message}"))),
            }
        };
        table.into_iter().map(read).collect()
    }

    /// An error about it, with its line.
    fn error(&self, message: String) -> SceneError {
        let problem = SceneError::Lamp { name: self.name.clone(), message };
        match &self.origin {
            Some((path, line)) => {
                SceneError::In { path: path.clone(), line: Some(*line), problem: Box::new(problem) }
            }
            None => problem,
        }
    }
}

fn check_factor(factor: [f64; 3]) -> Result<(), String> {
    match factor.into_iter().find(|f| !(f.is_finite() && *f >= 0.0)) {
        Some(wrong) => Err(format!("{wrong}; it must be finite and 0 or more")),
        None => Ok(()),
    }
}

impl Scene {
    /// Multiplies the emission of lamps, each by the factor of its name.
    ///
    /// A name stands for all triangles of the mesh of that name if some of them emit. Otherwise it stands for all of the material of
    /// that name, or for all of its copies `NAME.1`, `NAME.2` and so on, which textures and fits make. `sun`, `sun.2` … are suns, in
    /// the order of [`Scene::suns`]. Where several names hold for a triangle, their factors are multiplied. Other triangles that share
    /// a material keep their light: those that change get a copy of it.
    ///
    /// If nothing emits any more, [`Scene::warnings`] says so.
    ///
    /// # Errors
    /// Fails if nothing of a name emits, if a factor is negative or not finite, or if the light becomes too strong to compute with. The
    /// scene is then as before.
    #[doc(hidden)]
    pub fn scale_lamps(&mut self, factors: &[LampFactor]) -> Result<(), SceneError> {
        let mut suns = self.suns.clone();
        let mut of: HashMap<u32, [f64; 3]> = HashMap::new();
        for lamp in factors {
            let product = |rgb: [f64; 3]| [0, 1, 2].map(|c| rgb[c] * lamp.factor[c]);
            check_factor(lamp.factor).map_err(|wrong| lamp.error(format!("the factor is {wrong}")))?;
            let too_bright = |wrong| lamp.error(format!("its light becomes {wrong}"));
            match self.named(&lamp.name) {
                Some(Named::Sun(sun)) => {
                    suns[sun].irradiance = product(suns[sun].irradiance);
                    check_light(suns[sun].irradiance).map_err(too_bright)?;
                }
                Some(Named::Triangles(triangles)) => {
                    for triangle in triangles {
                        let factor = of.entry(triangle).or_insert([1.0; 3]);
                        *factor = product(*factor);
                        let emission = self.material(triangle as usize).emission;
                        check_light([0, 1, 2].map(|c| emission[c] * factor[c])).map_err(too_bright)?;
                    }
                }
                None => return Err(lamp.error(self.no_lamp(&lamp.name))),
            }
        }
        self.suns = suns;
        self.scale_emission(&of);
        self.warn_if_dark();
        Ok(())
    }

    /// Names for [`Scene::scale_lamps`] that cover all that emits: suns; each mesh that emits all over, or has very many materials that
    /// emit; and of other meshes the materials that emit.
    #[doc(hidden)]
    pub fn lamps(&self) -> Vec<String> {
        let materials: Vec<&str> = self.materials.iter().map(|material| material.name.as_str()).collect();
        self.lamps_named(&materials)
    }

    /// Writes a factor of 1 for each of [`Scene::lamps`], for [`LampFactor::read`], with the names that [`Scene::save`] writes.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    #[doc(hidden)]
    pub fn save_lamps(&self, path: &Path) -> Result<(), OutputError> {
        let names = self.saved_names();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let table: BTreeMap<String, f64> =
            self.lamps_named(&names).into_iter().map(|name| (name, 1.0)).collect();
        let text = toml::to_string(&table);
        atomic_write(path, |file| {
            writeln!(
                file,
                "# Factors of the light of each lamp, one number or [R, G, B]; 0 switches it off."
            )?;
            file.write_all(text.map_err(Error::other)?.as_bytes())
        })
    }

    /// [`Scene::lamps`], with other names of materials.
    fn lamps_named(&self, materials: &[&str]) -> Vec<String> {
        let lit = (0..).zip(&self.suns).filter(|(_, sun)| sun.irradiance != [0.0; 3]);
        let mut names: Vec<String> = lit.map(|(number, _)| sun_name(number)).collect();
        let flat: HashSet<u32> = self.degenerate.iter().copied().collect();
        let emitting = self.emitting_meshes(&flat);
        for mesh in &self.meshes {
            let solid = || mesh.range.clone().filter(|t| !flat.contains(t));
            let of_mesh: Vec<u32> = solid().filter(|&t| self.emits(t)).collect();
            let mut own: Vec<&str> = Vec::new();
            for &t in &of_mesh {
                let name = materials[self.triangles[t as usize].material as usize];
                if own.last() != Some(&name) && !own.contains(&name) {
                    own.push(name);
                }
                if own.len() > MANY {
                    break;
                }
            }
            // A material is meant by its name only where no mesh is.
            let hidden = own.iter().any(|name| emitting.contains(name) || sun_number(name).is_some());
            if of_mesh.len() == solid().count() || own.len() > MANY || hidden {
                own = if of_mesh.is_empty() { Vec::new() } else { vec![&mesh.name] };
            }
            names.extend(own.into_iter().map(str::to_owned));
        }
        let mut taken = HashSet::new();
        names.retain(|name| taken.insert(name.clone()));
        names
    }

    fn emits(&self, triangle: u32) -> bool {
        self.material(triangle as usize).emits()
    }

    /// Names of meshes some of whose triangles emit.
    fn emitting_meshes(&self, flat: &HashSet<u32>) -> HashSet<&str> {
        let emits = |mesh: &&Mesh| mesh.range.clone().any(|t| !flat.contains(&t) && self.emits(t));
        self.meshes.iter().filter(emits).map(|mesh| mesh.name.as_str()).collect()
    }

    /// What emits and has a name.
    fn named(&self, name: &str) -> Option<Named> {
        let some = |triangles: Vec<u32>| (!triangles.is_empty()).then_some(Named::Triangles(triangles));
        let meshes = self.meshes.iter().filter(|mesh| mesh.name == name);
        let of_mesh = meshes.flat_map(|mesh| mesh.range.clone()).filter(|&t| self.emits(t)).collect();
        let of_materials = |is: &dyn Fn(&Material) -> bool| {
            let is: Vec<bool> = self.materials.iter().map(|m| m.emits() && is(m)).collect();
            let all = 0..self.triangles.len() as u32;
            all.filter(|&t| is[self.triangles[t as usize].material as usize]).collect()
        };
        some(of_mesh)
            .or_else(|| sun_number(name).filter(|&sun| sun < self.suns.len()).map(Named::Sun))
            .or_else(|| some(of_materials(&|material| material.name == name)))
            .or_else(|| some(of_materials(&|material| is_copy(&material.name, name))))
    }

    /// Says that nothing of a name emits, and what does.
    fn no_lamp(&self, name: &str) -> String {
        let lamps = self.lamps();
        let names = || lamps.iter().map(String::as_str);
        let known = self.meshes.iter().map(|m| &m.name).chain(self.materials.iter().map(|m| &m.name));
        let what =
            if { known }.any(|known| known == name) { "it does not emit" } else { "nothing has this name" };
        let near = nearest(name, names()).map_or(String::new(), |near| format!("; did you mean \"{near}\"?"));
        match lamps.is_empty() {
            true => format!(
                "{what}; nothing in the scene emits: give a material an emission, or add a sky or a sun"
            ),
            false => format!("{what}; these emit: {}{near}", quoted(names())),
        }
    }

    /// Multiplies the emission of triangles. Those of a material that change alike share a copy of it, or it changes itself if all do.
    fn scale_emission(&mut self, factors: &HashMap<u32, [f64; 3]>) {
        let factor_of = |triangle: usize| factors.get(&(triangle as u32)).copied().unwrap_or([1.0; 3]);
        // Which factors the triangles of each material have: the first, and whether there are others.
        let mut common: Vec<Option<([f64; 3], bool)>> = vec![None; self.materials.len()];
        for (at, triangle) in self.triangles.iter().enumerate() {
            let factor = factor_of(at);
            let of = common[triangle.material as usize].get_or_insert((factor, false));
            of.1 |= of.0 != factor;
        }
        let scaled =
            |material: &Material, factor: [f64; 3]| [0, 1, 2].map(|c| material.emission[c] * factor[c]);
        let mut taken: HashSet<String> =
            self.materials.iter().map(|material| material.name.clone()).collect();
        let mut counts: HashMap<u32, u64> = HashMap::new();
        let mut copies: HashMap<(u32, [u64; 3]), u32> = HashMap::new();
        for at in 0..self.triangles.len() {
            let (factor, of) = (factor_of(at), self.triangles[at].material);
            if factor == [1.0; 3] || common[of as usize].is_none_or(|(_, differ)| !differ) {
                continue;
            }
            let copy = *copies.entry((of, factor.map(f64::to_bits))).or_insert_with(|| {
                let material = &self.materials[of as usize];
                let name =
                    numbered(&material.name, counts.entry(of).or_default(), |name| taken.contains(name));
                taken.insert(name.clone());
                let emission = scaled(material, factor);
                self.materials.push(Material { name, emission, ..material.clone() });
                self.materials.len() as u32 - 1
            });
            self.triangles[at].material = copy;
        }
        for (material, of) in self.materials.iter_mut().zip(common) {
            if let Some((factor, false)) = of {
                material.emission = scaled(material, factor);
            }
        }
    }
}

/// `sun`, `sun.2`, `sun.3` and so on.
fn sun_name(number: usize) -> String {
    if number == 0 { String::from("sun") } else { format!("sun.{}", number + 1) }
}

/// The place of a sun with a name in [`Scene::suns`].
fn sun_number(name: &str) -> Option<usize> {
    match name.strip_prefix("sun")? {
        "" => Some(0),
        rest => {
            rest.strip_prefix('.')?.parse().ok().filter(|&number: &usize| number > 1).map(|number| number - 1)
        }
    }
}

/// Whether `name` is `of` with numbers after it, as `lamp.3` or `lamp.3.1` of `lamp`.
fn is_copy(name: &str, of: &str) -> bool {
    let rest = name.strip_prefix(of).and_then(|rest| rest.strip_prefix('.'));
    rest.is_some_and(|rest| {
        rest.split('.').all(|number| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
    })
}

#[cfg(test)]
mod tests {
    use super::super::{LoadOptions, Sun, Triangle};
    use super::*;
    use glam::DVec3;

    /// Six triangles of three meshes: "panel" and "wall" share a material that emits, "lamp" has one of its own and a wall's.
    fn scene() -> Scene {
        let corners = |t: usize| [DVec3::ZERO, DVec3::X, DVec3::Y].map(|corner| corner + t as f64 * DVec3::Z);
        let vertices = (0..6).flat_map(corners).collect();
        let triangle =
            |(t, material): (u32, u32)| Triangle { vertices: [3 * t, 3 * t + 1, 3 * t + 2], material };
        let triangles = (0..).zip([0, 0, 0, 0, 1, 2]).map(triangle).collect();
        let material =
            |name: &str, emission: f64| Material { emission: [emission; 3], ..Material::named(name) };
        let materials = vec![material("white", 1.0), material("bulb.1", 5.0), material("grey", 0.0)];
        let mut scene = Scene::new("s", vertices, triangles, materials).expect("a scene");
        let mesh = |name: &str, range| Mesh { name: name.to_owned(), range };
        scene.meshes = vec![mesh("panel", 0..2), mesh("wall", 2..4), mesh("lamp", 4..6)];
        scene
    }

    fn scale(scene: &mut Scene, factors: &[(&str, f64)]) -> Result<(), String> {
        let factors: Vec<LampFactor> =
            factors.iter().map(|(name, factor)| LampFactor::new(*name, [*factor; 3])).collect();
        scene.scale_lamps(&factors).map_err(|error| error.to_string())
    }

    fn emissions(scene: &Scene) -> [f64; 6] {
        [0, 1, 2, 3, 4, 5].map(|t| scene.material(t).emission[0])
    }

    #[test]
    fn meshes_change_without_what_shares_their_material() {
        let mut scene = scene();
        scale(&mut scene, &[("panel", 0.0)]).expect("a lamp");
        assert_eq!(emissions(&scene), [0.0, 0.0, 1.0, 1.0, 5.0, 0.0]);
        assert_eq!(scene.material(0).name, "white.1");
        assert_eq!(scene.material(2).name, "white");
        assert!(scene.check(true).is_ok());
        assert_eq!(scene.lamps(), ["wall", "bulb.1"]);
    }

    #[test]
    fn materials_change_with_all_their_triangles_and_copies() {
        let mut scene = scene();
        scene.scale_lamps(&[LampFactor::new("white", [2.0, 3.0, 0.0])]).expect("a material");
        assert_eq!([0, 3].map(|t| scene.material(t).emission), [[2.0, 3.0, 0.0]; 2]);
        assert_eq!(scene.materials.len(), 3);
        scale(&mut scene, &[("bulb", 0.5), ("wall", 0.5), ("white", 0.5)]).expect("lamps");
        assert_eq!(emissions(&scene), [1.0, 1.0, 0.5, 0.5, 2.5, 0.0]);
    }

    #[test]
    fn suns_and_darkness() {
        let mut scene = scene();
        scene.suns = vec![Sun::new(-DVec3::Z, [2.0; 3]); 2];
        assert_eq!(scene.lamps(), ["sun", "sun.2", "panel", "wall", "bulb.1"]);
        let all = [("panel", 0.0), ("wall", 0.0), ("lamp", 0.0), ("sun", 0.0)];
        scale(&mut scene, &all).expect("lamps");
        assert_eq!([0, 1].map(|k| scene.suns[k].irradiance[0]), [0.0, 2.0]);
        assert!(scene.warnings.iter().all(|warning| !warning.contains("black")));
        scale(&mut scene, &[("sun.2", 0.0)]).expect("a sun");
        assert!(scene.warnings.iter().any(|warning| warning.contains("the picture will be black")));
        let error = scale(&mut scene, &[("panel", 1.0)]).expect_err("dark");
        assert!(error.contains("does not emit") && error.contains("nothing in the scene emits"), "{error}");
    }

    #[test]
    fn what_is_no_lamp_or_no_factor_is_refused() {
        let mut scene = scene();
        let mut refused = |factors: &[(&str, f64)], parts: &[&str]| {
            let error = scale(&mut scene, factors).expect_err("refused");
            parts.iter().for_each(|part| assert!(error.contains(part), "{error} lacks {part}"));
            assert_eq!(emissions(&scene), [1.0, 1.0, 1.0, 1.0, 5.0, 0.0]);
        };
        refused(
            &[("wall", 0.0), ("panl", 0.0)],
            &[
                "lamp \"panl\"",
                "nothing has this name",
                "did you mean \"panel\"?",
                "\"panel\", \"wall\", \"bulb.1\"",
            ],
        );
        refused(&[("grey", 2.0)], &["lamp \"grey\"", "does not emit"]);
        refused(&[("sun", 2.0)], &["nothing has this name"]);
        refused(&[("wall", -1.0)], &["the factor is -1", "0 or more"]);
        refused(&[("wall", f64::NAN)], &["finite"]);
        refused(&[("wall", 1e300), ("lamp", 0.0)], &["its light becomes", "larger unit"]);
    }

    #[test]
    fn factors_come_back_from_their_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut scene = scene();
        scene.materials[1].name = String::from("bulb #1");
        let [saved, lamps] = ["s.toml", "relight.toml"].map(|name| folder.path().join(name));
        scene.save(&saved).expect("written");
        scene.save_lamps(&lamps).expect("written");
        let mut factors = LampFactor::read(&lamps).expect("factors");
        let names: Vec<&str> = factors.iter().map(|lamp| lamp.name.as_str()).collect();
        assert_eq!(names, ["bulb _1", "panel", "wall"]);
        assert!(factors.iter().all(|lamp| lamp.factor == [1.0; 3]));
        let mut loaded = Scene::load(&saved, &LoadOptions::default()).expect("a scene");
        factors[0].factor = [0.0; 3];
        loaded.scale_lamps(&factors).expect("lamps");
        assert_eq!(emissions(&loaded), [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);

        let refused = |text: &str, parts: &[&str]| {
            std::fs::write(&lamps, text).expect("written");
            let scaled = |factors: Vec<LampFactor>| loaded.clone().scale_lamps(&factors);
            let error = LampFactor::read(&lamps).and_then(scaled).expect_err("refused").to_string();
            parts.iter().for_each(|part| assert!(error.contains(part), "{error} lacks {part}"));
        };
        refused("panel = 1\n\"wall\" = -2\n", &["relight.toml:2", "\"wall\" is -2"]);
        refused("panel = 1\n\nwal = [1, 0.5, 0]\n", &["relight.toml:3", "lamp \"wal\"", "\"wall\""]);
        refused("panel = \"off\"\n", &["relight.toml:1"]);
    }
}
