//! Option structs that can gain fields without breaking their users.

/// For each field of an option struct, a method that sets it and returns the struct. Such structs are
/// `#[non_exhaustive]`: other crates start from a default and set fields.
#[macro_export]
macro_rules! setters {
    ($options:ty { $($(#[$attribute:meta])* $field:ident: $kind:ty),+ $(,)? }) => {
        impl $options {
            $(
                #[doc = concat!("Sets `", stringify!($field), "`.")]
                $(#[$attribute])*
                #[must_use]
                pub fn $field(mut self, $field: $kind) -> Self {
                    self.$field = $field;
                    self
                }
            )+
        }
    };
}
