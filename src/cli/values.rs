//! Settings as words of the command line.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error;

/// The words of precisions.
pub const PRECISIONS: [&str; 2] = ["f32", "f64"];
/// The words of solvers.
pub const SOLVERS: [&str; 3] = ["auto", "fixed-point", "gmres"];
/// The words of ways to the light of lamps.
pub const LAMPS: [&str; 4] = ["auto", "exact", "sampled", "antiradiance"];
/// The words of ways to visibility.
pub const VISIBILITIES: [&str; 2] = ["explicit", "implicit"];
/// The words of ways to turn faces.
pub const ORIENTATIONS: [&str; 2] = ["auto", "keep"];
/// The words of shadings.
pub const SHADINGS: [&str; 2] = ["face", "gathered"];
/// The words of ways to reflections in pictures.
pub const REFLECTIONS: [&str; 3] = ["rays", "fixed-rays", "bins"];

/// A parser of one of these words, with the meaning it has in scene files.
pub fn word<T>(words: impl IntoIterator<Item = &'static str>) -> impl TypedValueParser<Value = T>
where
    T: for<'a> Deserialize<'a> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(words)
        .try_map(|word| T::deserialize(IntoDeserializer::<Error>::into_deserializer(word.as_str())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_render::shading::{Reflections, Shading};
    use antirad_scene::{Lamps, Orient, Precision, SolverChoice, VisibilityChoice};

    /// Every word names another value.
    fn read<T: for<'a> Deserialize<'a> + PartialEq + std::fmt::Debug>(words: &[&str]) {
        let read = |word: &&str| T::deserialize(IntoDeserializer::<Error>::into_deserializer(*word));
        let values: Vec<T> = words.iter().map(|word| read(word).expect("a value")).collect();
        for (i, value) in values.iter().enumerate() {
            assert!(!values[..i].contains(value), "{value:?}");
        }
    }

    #[test]
    fn words_are_those_of_scene_files() {
        read::<Precision>(&PRECISIONS);
        read::<SolverChoice>(&SOLVERS);
        read::<Lamps>(&LAMPS);
        read::<VisibilityChoice>(&VISIBILITIES);
        read::<Orient>(&ORIENTATIONS);
        read::<Shading>(&SHADINGS);
        read::<Reflections>(&REFLECTIONS);
    }
}
