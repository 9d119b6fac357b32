//! The declaration of a stage, and what its author writes.
//!
//! From one [`stage!`](crate::stage!) declaration derive: spec parsing and its messages, plan validation, `explain`,
//! lineage, cache keys, column pruning, `magline stages` and the reference pages.

use std::{any::Any, collections::BTreeMap, ops::Range, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch};

use crate::{Column, Fault, Literal, Shape, metric::Metric};

/// How much of a survey a stage must see at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grain {
    /// One whole flight line, in time order.
    Line,
    /// Every line that its `where` selects.
    Survey,
    /// Whole maps, and no flight lines.
    Map,
}

impl Grain {
    /// What a stage of this grain yields that does not say so.
    pub const fn usually_yields(self) -> TableKind {
        match self {
            Grain::Line => TableKind::Lines,
            Grain::Survey => TableKind::Model,
            Grain::Map => TableKind::Map,
        }
    }
}

/// The kind of table that a stage yields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableKind {
    /// Flight lines.
    Lines,
    /// A model, or another small table of a whole survey.
    Model,
    /// A map with the columns of [`crate::map::made_columns`].
    Map,
}

/// What a stage reads through one of its inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// A table of flight lines: the line at hand, or each in turn for a survey stage.
    Lines,
    /// One or several such tables.
    ManyLines,
    /// The model table of a fit.
    Model,
    /// An anomaly map.
    Map,
    /// One or several anomaly maps.
    ManyMaps,
    /// A table of scores.
    Scores,
}

/// One input of a stage: the key in the spec that names the table.
#[derive(Clone, Copy, Debug)]
pub struct InputDecl {
    /// The key, such as `input` or `map`.
    pub name: &'static str,
    /// Its kind.
    pub kind: InputKind,
    /// Whether it may be left out.
    pub optional: bool,
}

/// What a table is, seen from the plan.
#[derive(Clone, Debug)]
pub enum Table {
    /// Flight lines with these columns.
    Lines(Shape),
    /// A fitted model with these columns, and the columns of flight lines it must be applied to.
    Model {
        /// The columns of the model table.
        shape: Shape,
        /// The columns a line must have for the model to be applied.
        features: Vec<String>,
    },
    /// An anomaly map.
    Map(Shape),
}

impl Table {
    /// Its columns.
    pub fn shape(&self) -> &Shape {
        match self {
            Table::Lines(s) | Table::Map(s) | Table::Model { shape: s, .. } => s,
        }
    }

    /// The word for it.
    pub fn kind(&self) -> &'static str {
        match self {
            Table::Lines(_) => "a table of flight lines",
            Table::Model { .. } => "a model table",
            Table::Map(_) => "a map",
        }
    }
}

/// Which columns of the first input go on into the stage's own table, row by row.
#[derive(Clone, Debug, PartialEq)]
pub enum Passes {
    /// All of them: the stage appends columns.
    All,
    /// These only; the rows stay the same.
    Only(Vec<String>),
    /// None: the rows are new ones.
    None,
}

/// What a stage reads and yields, given the columns that reach it.
#[derive(Clone, Debug, PartialEq)]
pub struct Yield {
    /// The columns it makes.
    pub columns: Vec<Column>,
    /// What goes through unchanged.
    pub passes: Passes,
    /// The columns it is handed, per input (all inputs, in the declared order).
    pub reads: Vec<Vec<String>>,
    /// Samples per second of what it yields, where it made them even.
    pub rate_hz: Option<f64>,
    /// For a fit: the columns of a line that applying the model takes.
    pub features: Vec<String>,
    /// Whether a line may lack a column that is read: it is then handed over as NaN or null. Otherwise the line fails.
    pub lenient: bool,
    /// Whether the table is small and belongs into one file (models, scores).
    pub tidy: bool,
    /// What the user should know of a choice made automatically.
    pub notes: Vec<String>,
}

impl Yield {
    /// A stage that appends `columns` and reads `reads` of its first input.
    pub fn append<S: AsRef<str>>(columns: Vec<Column>, reads: &[S]) -> Self {
        Self {
            columns,
            passes: Passes::All,
            reads: vec![reads.iter().map(|s| s.as_ref().to_owned()).collect()],
            rate_hz: None,
            features: vec![],
            lenient: false,
            tidy: false,
            notes: vec![],
        }
    }
}

/// Something built once for all lines, such as the spline coefficients of a map.
pub type Prepared = Option<Arc<dyn Any + Send + Sync>>;

/// What a stage is handed for one line: only what it declared.
#[derive(Clone)]
pub struct LineIn {
    /// The flight identifier.
    pub flight: String,
    /// The line identifier.
    pub line: String,
    /// The columns it reads, per input; a model or map comes whole.
    pub inputs: Vec<RecordBatch>,
    /// The rows its `where` selects; all when there is none.
    pub keep: Option<Vec<bool>>,
    /// What [`Stage::prepare`] made.
    pub prepared: Prepared,
}

/// One survey stage at work: `map` may run on many lines at a time, `finish` sees the parts in line order.
pub trait Gather: Send + Sync {
    /// Reduces one line to what the answer needs of it.
    ///
    /// # Errors
    /// When the line cannot be used; the others go on without it.
    fn map(&self, line: &LineIn) -> Result<Box<dyn Any + Send>, Fault>;

    /// Which points cannot use a line that was mapped, by their place, and why. They go on without it, as those of all
    /// points do without a line that [`Gather::map`] refused.
    fn refused(&self, _part: &(dyn Any + Send)) -> Vec<(usize, Fault)> {
        vec![]
    }

    /// The table of each point, in the points' order.
    fn finish(&self, parts: Vec<Box<dyn Any + Send>>) -> Vec<Result<Vec<ArrayRef>, Fault>>;
}

/// What the [`stage!`](crate::stage!) declaration writes for a stage.
pub trait Declared {
    /// Every parameter in its one spelling.
    fn canonical(&self) -> Vec<(&'static str, String)>;
}

/// What the author of a stage writes.
pub trait Stage: Declared + Any + Send + Sync + Sized {
    /// The columns it reads and makes, given the tables that reach it.
    ///
    /// # Errors
    /// All that is wrong with the parameters or the tables, before anything runs.
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>>;

    /// Why the parameter `key` has no say beside the others, such as that it belongs to another model than the one that is
    /// fitted; `None` where it has. What has no say is left out of the key, so that points of a sweep which differ in
    /// nothing else are computed once; given outright it is a fault.
    fn idle(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Arrays for the columns of [`Stage::yields`], in that order, for one line.
    ///
    /// # Errors
    /// When this line cannot be computed; the other lines go on.
    fn run(&self, _line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        Err(Fault::bug("the stage does not work on single lines"))
    }

    /// Arrays for the columns of [`Stage::yields`], in that order, of a stage of [`Grain::Map`]. `maps` are the whole
    /// maps, each on its own grid ([`crate::map`]), in the order of the inputs.
    ///
    /// # Errors
    /// When the map cannot be computed.
    fn run_maps(&self, _maps: &[RecordBatch]) -> Result<Vec<ArrayRef>, Fault> {
        Err(Fault::bug("the stage does not work on maps"))
    }

    /// [`Stage::run`] of several points of a sweep over one line, for a stage that has something to share between them.
    ///
    /// All belong to the same flight and line, in the order of the plan; each has what it declared to read, so the
    /// columns need not be the same. One answer a point, in their order, and with the bits of [`Stage::run`]: what
    /// comes of a point does not depend on its company, and the fault of one leaves the others. All answers are in
    /// memory together. A panic takes the whole call with it: a caller that wants the other points catches it and runs
    /// them one at a time.
    fn run_points(points: &[(&Self, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>> {
        points.iter().map(|(stage, line)| stage.run(line)).collect()
    }

    /// What is the same for all lines, built once. `inputs` holds models and maps; line tables are empty batches.
    ///
    /// # Errors
    /// When a model or map cannot be used.
    fn prepare(&self, _inputs: &[RecordBatch]) -> Result<Prepared, Fault> {
        Ok(None)
    }

    /// The parameters that [`Stage::prepare`] depends on, in one spelling: all, unless a stage narrows them to share
    /// what it prepares between the points of a sweep.
    fn prepare_key(&self) -> String {
        self.canonical().iter().map(|(name, value)| format!("{name}={value};")).collect()
    }

    /// For survey stages: the points of a sweep that see the same lines, solved together.
    fn gather(_points: Vec<&Self>) -> Option<Box<dyn Gather>> {
        None
    }
}

/// A [`Stage`] whose type is forgotten.
pub trait StageDyn: Send + Sync {
    /// See [`Declared::canonical`]; without the parameters that are [idle](Stage::idle).
    fn canonical(&self) -> Vec<(&'static str, String)>;
    /// See [`Stage::idle`].
    fn idle(&self, key: &str) -> Option<Fault>;
    /// See [`Stage::yields`].
    ///
    /// # Errors
    /// As there.
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>>;
    /// See [`Stage::run`].
    ///
    /// # Errors
    /// As there.
    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault>;
    /// See [`Stage::run_maps`].
    ///
    /// # Errors
    /// As there.
    fn run_maps(&self, maps: &[RecordBatch]) -> Result<Vec<ArrayRef>, Fault>;
    /// See [`Stage::run_points`]; `self` stands for the type only. A point that is not of this stage's type is run by
    /// itself.
    fn run_points(&self, points: &[(&dyn StageDyn, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>>;
    /// See [`Stage::prepare`].
    ///
    /// # Errors
    /// As there.
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Prepared, Fault>;
    /// See [`Stage::prepare_key`].
    fn prepare_key(&self) -> String;
    /// See [`Stage::gather`]; `points` are of this stage's type.
    fn gather(&self, points: &[&dyn StageDyn]) -> Option<Box<dyn Gather>>;
    /// For the way back to the type.
    fn as_any(&self) -> &dyn Any;
}

impl<S: Stage> StageDyn for S {
    fn canonical(&self) -> Vec<(&'static str, String)> {
        Declared::canonical(self).into_iter().filter(|(key, _)| Stage::idle(self, key).is_none()).collect()
    }
    fn idle(&self, key: &str) -> Option<Fault> {
        Stage::idle(self, key)
    }
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        Stage::yields(self, inputs)
    }
    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        Stage::run(self, line)
    }
    fn run_maps(&self, maps: &[RecordBatch]) -> Result<Vec<ArrayRef>, Fault> {
        Stage::run_maps(self, maps)
    }
    fn run_points(&self, points: &[(&dyn StageDyn, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>> {
        let ours: Vec<(&S, &LineIn)> =
            points.iter().filter_map(|(stage, line)| Some((stage.as_any().downcast_ref::<S>()?, *line))).collect();
        let mut answers = S::run_points(&ours).into_iter();
        let mut answer = |stage: &dyn StageDyn, line: &LineIn| match stage.as_any().is::<S>() {
            true => answers.next().unwrap_or_else(|| stage.run(line)),
            false => stage.run(line),
        };
        points.iter().map(|(stage, line)| answer(*stage, line)).collect()
    }
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Prepared, Fault> {
        Stage::prepare(self, inputs)
    }
    fn prepare_key(&self) -> String {
        Stage::prepare_key(self)
    }
    fn gather(&self, points: &[&dyn StageDyn]) -> Option<Box<dyn Gather>> {
        S::gather(points.iter().filter_map(|p| p.as_any().downcast_ref::<S>()).collect())
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// A parameter as the reference shows it.
#[derive(Clone, Debug)]
pub struct ParamDoc {
    /// The key in the spec.
    pub name: &'static str,
    /// The type in a word.
    pub type_name: &'static str,
    /// The unit; empty for none.
    pub unit: &'static str,
    /// The default in its canonical spelling; `None` where it must be given or may be left out.
    pub default: Option<String>,
    /// What happens where a parameter without a default is left out; `None` where it must be given.
    pub absent: Option<&'static str>,
    /// What values are allowed, in words.
    pub rule: String,
    /// What it does.
    pub doc: String,
}

/// One key of a stage as the spec gives it, with where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// Its value.
    pub value: Literal,
    /// The bytes of the key.
    pub key_at: Range<usize>,
    /// The bytes of the value.
    pub at: Range<usize>,
}

/// The parameters of a stage as the spec gives them.
pub type Args = BTreeMap<String, Given>;

/// How a stage is made from its parameters.
pub type Build = fn(&Args) -> Result<Arc<dyn StageDyn>, Vec<Fault>>;

/// One row of the catalogue: all that the planner, `explain`, lineage, keys and docs read of a stage.
#[derive(Clone, Copy)]
pub struct Entry {
    /// The word after `stage =`.
    pub name: &'static str,
    /// Raised whenever the answer changes.
    pub version: u32,
    /// How much it must see at once.
    pub grain: Grain,
    /// The kind of table that it yields.
    pub yields: TableKind,
    /// Its inputs.
    pub inputs: &'static [InputDecl],
    /// What it does, when you want it, what it refuses, source.
    pub doc: fn() -> String,
    /// A fragment of a spec that uses it, the table named like the stage. The examples of the catalogue, in its order,
    /// make one spec over a table of flights `flights` and a map `anomaly`; the reference prints them, and the test of
    /// the versions runs them.
    pub example: &'static str,
    /// What the reference shows besides; empty for most.
    pub more: fn() -> String,
    /// What a line is scored by, for a stage that makes a table of scores; empty for others.
    pub metrics: &'static [Metric],
    /// Its parameters.
    pub params: fn() -> Vec<ParamDoc>,
    /// Makes the stage from its parameters, or says all that is wrong with them.
    pub build: Build,
}

/// Joins `///` lines the way rustdoc does, keeping paragraphs and the rows of tables.
pub fn collect_doc(lines: &[&str]) -> String {
    let mut text = String::new();
    for line in lines.iter().map(|l| l.trim()) {
        if line.is_empty() {
            text.push_str("\n\n");
        } else {
            if !text.is_empty() && !text.ends_with('\n') {
                text.push(if line.starts_with('|') { '\n' } else { ' ' });
            }
            text.push_str(line);
        }
    }
    text
}

/// Faults for keys that are neither parameters of the stage nor of the plan.
pub fn unknown_keys(args: &Args, stage: &str, params: &[&str], plan: &[&str]) -> Vec<Fault> {
    let known: Vec<&str> = params.iter().chain(plan).copied().collect();
    args.iter()
        .filter(|(name, _)| !params.contains(&name.as_str()))
        .map(|(name, given)| {
            Fault::new(format!("`{stage}` has no parameter `{name}`")).nearest(name, &known).at(given.key_at.clone())
        })
        .collect()
}

/// Declares a stage once: name, version, grain, inputs, an example, parameters with unit, default, rule and
/// documentation. A parameter of a type `Option` says what happens where it is left out (`absent`). A stage that yields
/// another kind of table than is usual for its grain says so after the grain: `grain Survey, yields Map`. An input that
/// may be left out is the last: `inputs [map: Map, with: ManyMaps optional]`.
///
/// ```
/// use schemas::{stage, Fault, LineIn, Rule, Stage, Table, Yield};
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
///     fn yields(&self, _: &[&Table]) -> Result<Yield, Vec<Fault>> {
///         Ok(Yield::append(vec![], &[&self.column]))
///     }
///     fn run(&self, _: &LineIn) -> Result<Vec<arrow_array::ArrayRef>, Fault> {
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
        inputs [$($inp:ident : $kind:ident $($optional:ident)?),* $(,)?],
        example $example:literal;
        $(
            $(#[doc = $pd:literal])* $p:ident : $pt:ty, unit $unit:literal
            $(, default $def:expr)? $(, absent $absent:literal)? $(, rule $rule:expr)? ;
        )*
    ) => {
        $(#[doc = $d])*
        #[derive(Clone, Debug)]
        pub struct $Ty { $( $(#[doc = $pd])* pub $p: $pt, )* }

        impl $crate::Declared for $Ty {
            fn canonical(&self) -> Vec<(&'static str, String)> {
                vec![ $( (stringify!($p), $crate::Value::canonical(&self.$p)), )* ]
            }
        }

        impl $Ty {
            /// The name in a spec.
            pub const NAME: &'static str = $name;

            /// The row of the catalogue.
            pub fn entry() -> $crate::Entry {
                fn params() -> Vec<$crate::ParamDoc> {
                    vec![ $( $crate::ParamDoc {
                        name: stringify!($p),
                        type_name: <$pt as $crate::Value>::TYPE,
                        unit: $unit,
                        default: {
                            #[allow(unused_mut, unused_assignments)]
                            let mut x: Option<$pt> = None;
                            $( x = Some(<$pt>::from($def)); )?
                            x.as_ref().map($crate::Value::canonical)
                        },
                        absent: {
                            #[allow(unused_mut, unused_assignments)]
                            let mut text = <$pt as $crate::Value>::absent().map(|_: $pt| "");
                            $( let _ = stringify!($def); text = None; )?
                            $( text = Some($absent); )?
                            text
                        },
                        rule: {
                            #[allow(unused_mut, unused_assignments)]
                            let mut r = $crate::words_rule::<$pt>();
                            $( r = $rule; )?
                            r.words()
                        },
                        doc: $crate::collect_doc(&[$($pd),*]),
                    }, )* ]
                }
                fn build(args: &$crate::Args) -> Result<std::sync::Arc<dyn $crate::StageDyn>, Vec<$crate::Fault>> {
                    let mut faults = $crate::unknown_keys(args, $name, &[$(stringify!($p)),*], &[$(stringify!($inp)),*]);
                    $(
                        let $p: Option<$pt> = {
                            #[allow(unused_mut, unused_assignments)]
                            let mut given: Option<$pt> = <$pt as $crate::Value>::absent();
                            $( given = Some(<$pt>::from($def)); )?
                            #[allow(unused_mut, unused_assignments)]
                            let mut rule = $crate::Rule::Any;
                            $( rule = $rule; )?
                            $crate::read_param($name, stringify!($p), args, given, rule, &[$($pd),*], &mut faults)
                        };
                    )*
                    match ( $($p,)* ) {
                        ( $(Some($p),)* ) if faults.is_empty() => Ok(std::sync::Arc::new($Ty { $($p,)* })),
                        _ => Err(faults),
                    }
                }
                fn doc() -> String { $crate::collect_doc(&[$($d),*]) }
                $crate::Entry {
                    name: $name,
                    version: $v,
                    grain: $crate::Grain::$grain,
                    yields: {
                        #[allow(unused_mut, unused_assignments)]
                        let mut kind = $crate::Grain::$grain.usually_yields();
                        $( kind = $crate::TableKind::$kind_of_table; )?
                        kind
                    },
                    inputs: const { &[$($crate::InputDecl {
                        name: stringify!($inp),
                        kind: $crate::InputKind::$kind,
                        optional: $crate::is_optional(&[$(stringify!($optional))?]),
                    }),*] },
                    doc,
                    example: $example,
                    more: String::new,
                    metrics: &[],
                    params,
                    build,
                }
            }
        }
    };
}

/// Whether an input is followed by a word; the only one there is says that it may be left out.
#[doc(hidden)]
pub const fn is_optional(words: &[&str]) -> bool {
    !words.is_empty()
}

/// The words that a type allows by itself.
#[doc(hidden)]
pub fn words_rule<T: crate::Value>() -> crate::Rule {
    if T::WORDS.is_empty() { crate::Rule::Any } else { crate::Rule::OneOf(T::WORDS) }
}

/// Reads one parameter for the [`stage!`](crate::stage!) declaration.
#[doc(hidden)]
pub fn read_param<T: crate::Value>(
    stage: &str,
    name: &str,
    args: &Args,
    absent: Option<T>,
    rule: crate::Rule,
    doc: &[&str],
    faults: &mut Vec<Fault>,
) -> Option<T> {
    let Some(Given { value: literal, at, .. }) = args.get(name) else {
        if absent.is_none() {
            faults.push(Fault::new(format!("`{stage}` needs `{name}`")).help(collect_doc(doc)));
        }
        return absent;
    };
    let Some(value) = T::read(literal) else {
        if let (Some(word), false) = (literal.as_text(), T::WORDS.is_empty()) {
            faults.push(Fault::new(format!("`{name}` cannot be `{word}`")).nearest(word, T::WORDS).at(at.clone()));
            return None;
        }
        let what = format!("`{name}` of `{stage}` must be a {}, not a {}", T::TYPE, literal.type_name());
        faults.push(Fault::new(what).at(at.clone()));
        return None;
    };
    if let Err(fault) = value.check(&rule) {
        faults.push(Fault { what: format!("`{name}` {}", fault.what), ..fault }.at(at.clone()));
        return None;
    }
    Some(value)
}

#[cfg(test)]
mod tests {
    use arrow_array::{Array, Float64Array};

    use super::*;

    crate::stage! {
        /// A number.
        Number = "number", version 1, grain Line, inputs [input: Lines], example "";
        /// The number; a negative one is a fault.
        value: f64, unit "1";
    }

    crate::stage! {
        /// Another stage.
        Other = "other", version 1, grain Line, inputs [input: Lines], example "";
        /// The number of its columns: none.
        columns: usize, unit "1";
    }

    impl Stage for Number {
        fn yields(&self, _: &[&Table]) -> Result<Yield, Vec<Fault>> {
            Ok(Yield::append::<&str>(vec![], &[]))
        }
        fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
            let values = vec![self.value; line.line.len()];
            if self.value < 0.0 { Err(Fault::data("negative")) } else { Ok(vec![Arc::new(Float64Array::from(values))]) }
        }
    }

    impl Stage for Other {
        fn yields(&self, _: &[&Table]) -> Result<Yield, Vec<Fault>> {
            Ok(Yield::append::<&str>(vec![], &[]))
        }
        fn idle(&self, key: &str) -> Option<Fault> {
            (key == "columns" && self.columns == 0).then(|| Fault::new("none"))
        }
        fn run(&self, _: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
            Ok(vec![])
        }
    }

    #[test]
    fn law_what_has_no_say_is_not_in_the_key() {
        let canonical = |columns| StageDyn::canonical(&Other { columns });
        assert_eq!(canonical(0), []);
        assert_eq!(canonical(2), [("columns", "2".to_owned())]);
    }

    #[test]
    fn law_points_are_run_each_by_itself_unless_the_stage_knows_better() {
        let line = LineIn { flight: "1".into(), line: "1.01".into(), inputs: vec![], keep: None, prepared: None };
        let (one, bad, two) = (Number { value: 1.0 }, Number { value: -1.0 }, Number { value: 2.0 });
        let points: [(&dyn StageDyn, &LineIn); 4] =
            [(&one, &line), (&bad, &line), (&Other { columns: 0 }, &line), (&two, &line)];
        assert_eq!([Number::entry().name, Other::entry().name], [Number::NAME, Other::NAME]);
        for first in [&one as &dyn StageDyn, &Other { columns: 0 }] {
            let answers = first.run_points(&points);
            let columns: Vec<Option<usize>> = answers.iter().map(|a| a.as_ref().ok().map(Vec::len)).collect();
            assert_eq!(columns, [Some(1), None, Some(0), Some(1)]);
            let expected: ArrayRef = Arc::new(Float64Array::from(vec![2.0; 4]));
            assert!(answers[3].as_ref().is_ok_and(|arrays| arrays[0].to_data() == expected.to_data()));
        }
    }
}
