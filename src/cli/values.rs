//! Settings as words of the command line.

use crate::scene::{Lamps, Orient, Precision, SolverChoice};
use crate::shading::{Reflections, Shading};
use clap::ValueEnum;
use clap::builder::PossibleValue;

impl ValueEnum for Precision {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::F32, Self::F64]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }))
    }
}

impl ValueEnum for SolverChoice {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Auto, Self::FixedPoint, Self::Gmres]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::Auto => "auto",
            Self::FixedPoint => "fixed-point",
            Self::Gmres => "gmres",
        }))
    }
}

impl ValueEnum for Lamps {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Auto, Self::Exact, Self::Sampled, Self::Antiradiance]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::Auto => "auto",
            Self::Exact => "exact",
            Self::Sampled => "sampled",
            Self::Antiradiance => "antiradiance",
        }))
    }
}

impl ValueEnum for Orient {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Auto, Self::Keep]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::Auto => "auto",
            Self::Keep => "keep",
        }))
    }
}

impl ValueEnum for Shading {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Face, Self::Gathered]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::Face => "face",
            Self::Gathered => "gathered",
        }))
    }
}

impl ValueEnum for Reflections {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Rays, Self::FixedRays, Self::Bins]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::Rays => "rays",
            Self::FixedRays => "fixed-rays",
            Self::Bins => "bins",
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use serde::de::value::{Error, StrDeserializer};

    /// Scene files and the command line use the same words.
    fn agree<T: ValueEnum + PartialEq + std::fmt::Debug + for<'de> Deserialize<'de>>(count: usize) {
        assert_eq!(T::value_variants().len(), count);
        for variant in T::value_variants() {
            let word = variant.to_possible_value().expect("a word");
            let file: StrDeserializer<Error> =
                serde::de::IntoDeserializer::into_deserializer(word.get_name());
            assert_eq!(T::deserialize(file).as_ref(), Ok(variant));
            assert_eq!(T::from_str(word.get_name(), false).as_ref(), Ok(variant));
        }
    }

    #[test]
    fn words_are_those_of_scene_files() {
        agree::<Precision>(2);
        agree::<SolverChoice>(3);
        agree::<Lamps>(4);
        agree::<Orient>(2);
        agree::<Shading>(2);
        agree::<Reflections>(3);
    }
}
