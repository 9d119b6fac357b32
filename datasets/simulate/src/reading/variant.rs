//! Tables with a key that chooses the kind. The keys of a kind are its particular keys and the keys that all kinds have
//! in common.

use std::sync::Arc;

use schemas::{ChoiceKeys, ChoiceKind, ParamDoc, ParamReader};

/// Kind of a table in a spec, with the keys of this kind, which are read into a `T`.
pub struct SynthVariant<T: 'static> {
    /// Name in a spec.
    pub name: &'static str,
    /// The lines of its documentation.
    pub doc: &'static [&'static str],
    /// Keys of this kind.
    pub docs: fn() -> Vec<ParamDoc>,
    /// Reads the keys of this kind.
    pub read: fn(&mut ParamReader) -> Option<T>,
}

/// Value read from the keys of a kind.
pub trait SynthVariantValue: Send + Sync + Sized + 'static {
    /// The default kind.
    const DEFAULT: &'static str;
}

impl<T: SynthVariantValue> ChoiceKind for SynthVariant<T> {
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

    fn read(&self, reader: &mut ParamReader) -> Option<ChoiceKeys<T>> {
        Some(ChoiceKeys { keys: Arc::new((self.read)(reader)?), spelt: vec![] })
    }
}

/// Declares a [`SynthVariant`]: its documentation, its name, the struct of its own keys as in `params!`, and the value
/// constructed from them.
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
        pub(crate) const $NAME: $crate::reading::variant::SynthVariant<$T> = $crate::reading::variant::SynthVariant {
            name: $name,
            doc: &[$($d),*],
            docs: || <$Keys as schemas::Params>::docs(&schemas::ChoiceRegistry::default()),
            read: |reader| {
                let make: fn($Keys) -> $T = $make;
                <$Keys as schemas::Params>::read(reader, None).map(make)
            },
        };
    };
}
pub(crate) use variant;
