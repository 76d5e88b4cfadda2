//! Option structs, to which fields can be added without breaking those who make them.

/// A method for each field of an option struct that sets it and gives the struct back. Such structs are
/// `#[non_exhaustive]`: other crates start at a default and change what they like.
macro_rules! setters {
    ($options:ty { $($field:ident: $kind:ty),+ $(,)? }) => {
        impl $options {
            $(
                #[doc = concat!("The same with another `", stringify!($field), "`.")]
                #[must_use]
                pub fn $field(mut self, $field: $kind) -> Self {
                    self.$field = $field;
                    self
                }
            )+
        }
    };
}

pub(crate) use setters;
