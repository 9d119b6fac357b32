//! Tables with a key that chooses the kind. Each kind has its own keys and the keys of all kinds.

use std::sync::Arc;

use schemas::{Kind, Own, ParamDoc, Reader};

/// A kind that a table can be, and how its own keys become a `T`.
pub struct Variant<T: 'static> {
    /// Its name in a spec.
    pub name: &'static str,
    /// The lines of its documentation.
    pub doc: &'static [&'static str],
    /// Its own keys.
    pub docs: fn() -> Vec<ParamDoc>,
    /// Reads its own keys.
    pub read: fn(&mut Reader) -> Option<T>,
}

/// The value that the keys of a kind give.
pub trait Varied: Send + Sync + Sized + 'static {
    /// The default kind.
    const DEFAULT: &'static str;
}

impl<T: Varied> Kind for Variant<T> {
    type Keys = T;
    const DEFAULT: Option<&'static str> = Some(T::DEFAULT);

    fn name(&self) -> &'static str {
        self.name
    }

    fn version(&self) -> u32 {
        1
    }

    fn docs(&self) -> Vec<ParamDoc> {
        (self.docs)()
    }

    fn read(&self, reader: &mut Reader) -> Option<Own<T>> {
        Some(Own { keys: Arc::new((self.read)(reader)?), spelt: vec![] })
    }
}

/// Declares a [`Variant`]: its documentation, its name, the struct of its own keys as in `params!`, and the value made
/// of them.
macro_rules! variant {
    (
        $(#[doc = $d:literal])*
        $NAME:ident : $T:ty = $name:literal, $make:expr;
        struct $Keys:ident $(, groups [$($g:ident : $gt:ty),* $(,)?])?;
        $($keys:tt)*
    ) => {
        schemas::params! {
            $(#[doc = $d])*
            pub struct $Keys $(, groups [$($g: $gt),*])?;
            $($keys)*
        }

        $(#[doc = $d])*
        pub(crate) const $NAME: $crate::reading::variant::Variant<$T> = $crate::reading::variant::Variant {
            name: $name,
            doc: &[$($d),*],
            docs: || <$Keys as schemas::Params>::docs(&schemas::Lists::default()),
            read: |reader| {
                let make: fn($Keys) -> $T = $make;
                <$Keys as schemas::Params>::read(reader, None).map(make)
            },
        };
    };
}
pub(crate) use variant;
