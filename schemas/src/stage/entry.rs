//! The row of a stage in the catalogue, and the macro that declares a stage.

use std::sync::Arc;

use super::{AnyStage, Grain, InputDecl, Stage, StageRole, TableKind};
use crate::{ChoiceRegistry, Fault, ParamDoc, ParamReader, SpecEntries, collect_doc, metric::Metric};

/// Constructor of a stage from its parameters; fails with all their faults and positions.
pub type StageBuilder = Arc<dyn Fn(&SpecEntries) -> Result<AnyStage, Vec<Fault>> + Send + Sync>;

/// One row of the catalogue, which the planner, `explain`, lineage, keys and docs use.
#[derive(Clone)]
pub struct StageEntry {
    /// The word after `stage =`.
    pub name: &'static str,
    /// Version, raised when the results change.
    pub version: u32,
    /// The part of a survey that the stage processes at once.
    pub grain: Grain,
    /// The kind of table that the stage yields.
    pub yields: TableKind,
    /// Purpose by which views of results find the stage; `None` without such a view.
    pub role: Option<StageRole>,
    /// Inputs.
    pub inputs: &'static [InputDecl],
    /// Documentation: purpose, use, rejected input and source.
    pub doc: String,
    /// A fragment of a spec that uses the stage, with the stage's name as the table's name. In the order of the
    /// catalogue, the examples make one spec over flights `flights`, a map `anomaly` and a record `observatory`. The
    /// reference prints them, and the test of the versions runs them.
    pub example: &'static str,
    /// The choices of one of the stage's keys, such as the models of a fit.
    pub kinds: Vec<ChoiceDoc>,
    /// The metrics of a stage that makes a table of scores; empty for others.
    pub metrics: Vec<Metric>,
    /// Parameters.
    pub params: Vec<ParamDoc>,
    /// Makes the stage from its parameters, or fails with all their faults.
    pub build: StageBuilder,
}

/// One of the choices of a key of a stage, as the reference shows it.
#[derive(Clone, Debug)]
pub struct ChoiceDoc {
    /// The key that selects the choice.
    pub key: &'static str,
    /// Name.
    pub name: &'static str,
    /// Purpose, use, source.
    pub doc: String,
    /// Additional facts, one per line, such as the default of a setting.
    pub facts: Vec<String>,
    /// Keys of the choice.
    pub params: Vec<ParamDoc>,
    /// Keys that the example of the stage sets for this choice, one per line; may be empty.
    pub example: &'static str,
}

/// Declaration of a stage by [`stage!`](crate::stage!), without its parameters.
#[doc(hidden)]
pub struct StageHeader {
    pub name: &'static str,
    pub version: u32,
    pub grain: Grain,
    pub yields: TableKind,
    pub role: Option<StageRole>,
    pub inputs: &'static [InputDecl],
    pub doc: &'static [&'static str],
    pub example: &'static str,
}

impl StageEntry {
    /// The row of a stage `S` with kinds from `lists`.
    #[doc(hidden)]
    pub fn new<S: Stage>(head: StageHeader, lists: ChoiceRegistry, erase: fn(Arc<S>) -> AnyStage) -> StageEntry {
        let StageHeader { name, version, grain, yields, role, inputs, doc, example } = head;
        let params = S::docs(&lists);
        let known: Vec<&str> = params.iter().map(|p| p.name).collect();
        let build = move |args: &SpecEntries| -> Result<AnyStage, Vec<Fault>> {
            let mut reader = ParamReader::new(name, args, None, &lists);
            let stage = S::read(&mut reader, None);
            let inputs: Vec<&str> = inputs.iter().map(|input| input.name).collect();
            reader.unknown_keys(&known, &inputs);
            let faults = reader.into_faults();
            match stage {
                Some(stage) if faults.is_empty() => Ok(erase(Arc::new(stage))),
                Some(_) | None => Err(faults),
            }
        };
        let (doc, build) = (collect_doc(doc), Arc::new(build));
        StageEntry {
            name,
            version,
            grain,
            yields,
            role,
            inputs,
            doc,
            example,
            kinds: vec![],
            metrics: vec![],
            params,
            build,
        }
    }
}

/// Declares a stage once: name, version, grain, inputs, an example, parameters with unit, default, rule and
/// documentation. The grain selects the trait that the stage implements: [`LineStage`](crate::LineStage),
/// [`SurveyStage`](crate::SurveyStage) or [`MapStage`](crate::MapStage). A parameter of type `Option` documents its
/// behaviour when unset (`absent`). A stage that yields a kind of table other than the default of its grain declares
/// it: `grain Survey, yields Map`. If views of results search for the stage, its role is declared after the kind of
/// table: `role Scores`. An optional input follows the required ones: `inputs [map: Map, with: ManyMaps optional]`.
///
/// ```
/// use schemas::{stage, Fault, LineInput, LineStage, Rule, Stage, Table, StageSchema};
/// stage! {
///     /// Multiplies a column.
///     Scale = "scale", version 1, grain Line, inputs [input: Lines], example r#"
/// [[stages]]
/// name   = "scale"
/// stage  = "scale"
/// input  = "flights"
/// column = "mag_1_c"
/// "#;
///     /// The column.
///     column: String, unit "";
///     /// The factor.
///     factor: f64, unit "1", default 2.0, rule Rule::Positive;
/// }
/// impl Stage for Scale {
///     fn yields(&self, _: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
///         Ok(StageSchema::append(vec![], &[&self.column]))
///     }
/// }
/// impl LineStage for Scale {
///     type Prepared = ();
///     fn run(&self, _: &LineInput, _: &()) -> Result<Vec<arrow_array::ArrayRef>, Fault> {
///         Ok(vec![])
///     }
/// }
/// assert_eq!(Scale::entry().name, "scale");
/// ```
#[macro_export]
macro_rules! stage {
    (
        $(#[doc = $d:literal])*
        $Ty:ident = $name:literal, version $v:literal, grain $grain:ident, $(yields $kind_of_table:ident,)?
        $(role $role:ident,)? inputs [$($inp:ident : $kind:ident $($optional:ident)?),* $(,)?],
        $(groups [$($g:ident : $gt:ty),* $(,)?],)? example $example:literal;
        $(
            $(#[doc = $pd:literal])* $p:ident : $pt:ty, unit $unit:literal
            $(, default $def:expr)? $(, absent $absent:literal)? $(, rule $rule:expr)? ;
        )*
    ) => {
        $crate::params! {
            $(#[doc = $d])*
            pub struct $Ty $(, groups [$($g: $gt),*])?;
            $(
                $(#[doc = $pd])* $p: $pt, unit $unit
                $(, default $def)? $(, absent $absent)? $(, rule $rule)?;
            )*
        }

        impl $Ty {
            /// The name in a spec.
            pub const NAME: &'static str = $name;

            /// The row of the catalogue.
            pub fn entry() -> $crate::StageEntry {
                Self::entry_with($crate::ChoiceRegistry::default())
            }

            /// The row of the catalogue, with the choices of its keys.
            pub fn entry_with(lists: $crate::ChoiceRegistry) -> $crate::StageEntry {
                let head = $crate::StageHeader {
                    name: $name,
                    version: $v,
                    grain: $crate::Grain::$grain,
                    yields: $crate::first([
                        $($crate::TableKind::$kind_of_table,)?
                        $crate::Grain::$grain.usually_yields(),
                    ]).unwrap_or($crate::Grain::$grain.usually_yields()),
                    role: $crate::first([$(Some($crate::StageRole::$role),)? None]).flatten(),
                    inputs: const { &[$($crate::InputDecl {
                        name: stringify!($inp),
                        kind: $crate::InputKind::$kind,
                        optional: $crate::is_optional(&[$(stringify!($optional))?]),
                    }),*] },
                    doc: &[$($d),*],
                    example: $example,
                };
                $crate::StageEntry::new::<Self>(head, lists, |stage| $crate::AnyStage::$grain(stage))
            }
        }
    };
}

/// Whether an input is followed by `optional`, the only word permitted there.
#[doc(hidden)]
pub const fn is_optional(words: &[&str]) -> bool {
    !words.is_empty()
}
