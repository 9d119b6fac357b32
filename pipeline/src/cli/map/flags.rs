//! Stage parameters as command-line flags. Names, defaults and strings come from the stage's declaration.

use std::marker::PhantomData;

use clap::{Arg, ArgAction, ArgMatches, Command, FromArgMatches, parser::ValueSource};
use schemas::{Fault, Literal, ParamDoc, SpecEntries, SpecEntry, Stage, StageEntry};
use stages::{
    map_continue::MapContinue, map_convert::MapConvert, map_fill::MapFill, map_grid::MapGrid, map_vector::MapVector,
};

use super::ExitReason;

/// Map stage whose parameters are command-line flags.
pub trait FlagStage: Stage + Clone {
    /// Declaration.
    fn declared() -> StageEntry;
    /// Flags with other spellings, or with a value that may be omitted.
    const SPELLINGS: &'static [FlagSpelling] = &[];
    /// Parameters that the command declares separately.
    const OWN: &'static [&'static str] = &[];
}

/// Other names of a flag, and the value that the flag has when it is given without a value.
pub struct FlagSpelling {
    /// The parameter.
    param: &'static str,
    /// Other names of the flag.
    names: &'static [&'static str],
    /// Value of the flag when it is given without a value.
    bare: Option<&'static str>,
}

const fn also(param: &'static str, names: &'static [&'static str]) -> FlagSpelling {
    FlagSpelling { param, names, bare: None }
}

impl FlagStage for MapGrid {
    fn declared() -> StageEntry {
        MapGrid::entry()
    }
    const SPELLINGS: &'static [FlagSpelling] = &[
        also("spacing_m", &["spacing"]),
        also("level_m", &["level"]),
        also("block_m", &["block"]),
        also("mask_m", &["mask"]),
        also("remove_diurnal", &["diurnal"]),
        also("crossing_height_m", &["crossing-height"]),
        FlagSpelling { param: "level_order", names: &["level-lines"], bare: Some("0") },
    ];
    // The flag names a column of the file.
    const OWN: &'static [&'static str] = &["value"];
}

impl FlagStage for MapFill {
    fn declared() -> StageEntry {
        MapFill::entry()
    }
    const SPELLINGS: &'static [FlagSpelling] =
        &[also("within_m", &["within"]), also("feather_m", &["feather"]), also("bias", &["level"])];
}

impl FlagStage for MapContinue {
    fn declared() -> StageEntry {
        MapContinue::entry()
    }
    const SPELLINGS: &'static [FlagSpelling] = &[also("alpha_m2", &["alpha"])];
    // The flag accepts several values.
    const OWN: &'static [&'static str] = &["to_m"];
}

impl FlagStage for MapConvert {
    fn declared() -> StageEntry {
        MapConvert::entry()
    }
    const SPELLINGS: &'static [FlagSpelling] = &[also("expand_nodes", &["expand"])];
}

impl FlagStage for MapVector {
    fn declared() -> StageEntry {
        MapVector::entry()
    }
    const SPELLINGS: &'static [FlagSpelling] =
        &[also("inclination_deg", &["inclination"]), also("declination_deg", &["declination"])];
    // The flag accepts several values.
    const OWN: &'static [&'static str] = &["component"];
}

/// Parameters of the stage `S` from the command line.
#[derive(Clone)]
pub struct StageFlags<S> {
    given: SpecEntries,
    of: PhantomData<S>,
}

fn params<S: FlagStage>() -> impl Iterator<Item = ParamDoc> {
    S::declared().params.into_iter().filter(|p| !S::OWN.contains(&p.name))
}

/// Flag of a parameter, without its dashes.
fn flag(param: &str) -> String {
    param.replace('_', "-")
}

/// Permitted words of a parameter.
fn words(param: &ParamDoc) -> Vec<&str> {
    if param.type_name == "text" { param.rule.split('`').skip(1).step_by(2).collect() } else { vec![] }
}

fn arg<S: FlagStage>(param: &ParamDoc) -> Arg {
    let mut help = param.doc.replace("\n\n", " ").replace('`', "");
    let unit = if param.unit.is_empty() || param.unit == "1" { String::new() } else { format!(" {}", param.unit) };
    let words = words(param);
    help += &match (&param.default, param.absent) {
        (Some(default), _) if param.type_name != "boolean" => {
            format!(" [default: {}{unit}]", default.trim_matches('"'))
        }
        (None, Some(absent)) if !absent.is_empty() => format!(" [unset: {}]", absent.replace('`', "")),
        _ => String::new(),
    };
    if !words.is_empty() {
        help += &format!(" [one of: {}]", words.join(", "));
    }
    let name = if param.unit.is_empty() || param.unit == "1" { param.type_name } else { param.unit };
    let arg = Arg::new(format!("stage.{}", param.name))
        .long(flag(param.name))
        .help(help)
        .value_name(name.replace(' ', "-").replace('`', "").to_uppercase())
        .action(ArgAction::Set)
        .allow_hyphen_values(param.type_name == "list")
        .allow_negative_numbers(true);
    let spelling = S::SPELLINGS.iter().find(|s| s.param == param.name);
    let arg = spelling.map_or(arg.clone(), |s| arg.visible_aliases(s.names.iter().copied()));
    match spelling.and_then(|s| s.bare) {
        Some(bare) => arg.num_args(0..=1).default_missing_value(bare),
        // The word after a Boolean flag is the next argument, not the value of the flag.
        None if param.type_name == "boolean" => arg.num_args(0..=1).default_missing_value("true").require_equals(true),
        None => arg,
    }
}

/// Parses a value as in a spec. The stage rejects a value of another type.
fn literal(text: &str, param: &ParamDoc) -> Literal {
    let number = |text: &str| {
        let whole = text.parse().map(Literal::Int);
        whole.or_else(|_| text.parse().map(Literal::Float)).unwrap_or_else(|_| Literal::Text(text.to_owned()))
    };
    match param.type_name {
        "text" => {
            // A word such as `a_b` may be written `a-b` in a command.
            let word = text.replace('-', "_");
            Literal::Text(if words(param).contains(&word.as_str()) { word } else { text.to_owned() })
        }
        "boolean" => text.parse().map_or(Literal::Text(text.to_owned()), Literal::Bool),
        // A list in brackets, as in a spec, is accepted too.
        "list" => {
            let inside = text.trim().strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(text);
            Literal::List(inside.split(',').map(|one| number(one.trim())).collect())
        }
        _ => number(text),
    }
}

impl<S: FlagStage> clap::Args for StageFlags<S> {
    fn augment_args(command: Command) -> Command {
        command.args(params::<S>().map(|param| arg::<S>(&param)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<S: FlagStage> FromArgMatches for StageFlags<S> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut given = SpecEntries::new();
        for param in params::<S>() {
            let id = format!("stage.{}", param.name);
            if matches.value_source(&id) == Some(ValueSource::CommandLine)
                && let Some(text) = matches.get_one::<String>(&id)
            {
                given.insert(param.name.to_owned(), SpecEntry { value: literal(text, &param), key_at: 0..0, at: 0..0 });
            }
        }
        Ok(StageFlags { given, of: PhantomData })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl<S: FlagStage> StageFlags<S> {
    /// Creates the stage with these parameters.
    ///
    /// # Errors
    /// Fails for values that the stage rejects. The message names the flag.
    pub fn stage(&self) -> Result<S, ExitReason> {
        let first = |faults: Vec<Fault>| faults.into_iter().next().map_or_else(Fault::default, in_flags::<S>);
        let with_help = |faults: Vec<Fault>| match first(faults) {
            fault if fault.what.contains("must be a list") && fault.help.is_none() => {
                fault.help("separate the values by commas, without spaces: 1,2,3,4")
            }
            fault => fault,
        };
        let built = (S::declared().build)(&self.given).map_err(with_help)?;
        let stage = built.as_any().downcast_ref::<S>().ok_or_else(|| Fault::bug("the stage has another type"))?;
        let unused = self.given.keys().find_map(|key| stage.unused_key(key));
        unused.map_or(Ok(stage.clone()), |fault| Err(in_flags::<S>(fault).into()))
    }
}

/// Terms used in specs, with the corresponding terms in commands.
const TERMS: [(&str, &str); 6] = [
    ("`map_fill`", "`magline map fill`"),
    ("`map_continue`", "`magline map continue`"),
    ("`alt_m`", "`--alt`"),
    ("`with`", "`--with`"),
    ("`drape`", "`--to-drape`"),
    ("\"", ""),
];

/// Replaces parameter names by flags in a fault of the stage `S`.
pub fn in_flags<S: FlagStage>(fault: Fault) -> Fault {
    let with_flag_names = |text: &str| {
        let mut text = text.to_owned();
        for param in S::declared().params {
            let flag = flag(param.name);
            text = text.replace(&format!("`{} = ", param.name), &format!("`--{flag} "));
            text = text.replace(&format!("`{}`", param.name), &format!("`--{flag}`"));
        }
        TERMS.iter().fold(text, |text, (spec, command)| text.replace(spec, command))
    };
    Fault { what: with_flag_names(&fault.what), help: fault.help.as_deref().map(with_flag_names), at: None, ..fault }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn parsed(args: &[&str]) -> Result<MapGrid, String> {
        let command = <StageFlags<MapGrid> as clap::Args>::augment_args(Command::new("grid"));
        let matches = command.try_get_matches_from(["grid"].iter().chain(args)).map_err(|e| e.to_string())?;
        let flags = StageFlags::<MapGrid>::from_arg_matches(&matches).map_err(|e| e.to_string())?;
        flags.stage().map_err(|stop| match stop {
            ExitReason::Wrong(text) | ExitReason::Failed(text) => text,
            _ => String::new(),
        })
    }

    #[test]
    fn unit_flags_match_the_parameters_of_the_stage() {
        let plain = parsed(&[]).unwrap();
        assert_eq!((plain.crossing_height_m, plain.damping, plain.keep_outliers), (50.0, 1.0, false));
        let grid = parsed(&["--spacing-m", "250", "--level=-20", "--keep-outliers", "--bounds", "-1,-2,3,4"]).unwrap();
        assert_eq!((grid.spacing_m, grid.level_m, grid.keep_outliers), (Some(250.0), Some(-20.0), true));
        assert_eq!(grid.bounds, Some(vec![-1.0, -2.0, 3.0, 4.0]));
        assert_eq!(parsed(&["--bounds", "[-1.0, -2, 3, 4]"]).unwrap().bounds, grid.bounds);
        assert_eq!(parsed(&["--spacing", "250", "--level-lines"]).unwrap().level_order, Some(0));
        assert_eq!(parsed(&["--level-order", "2", "--mask", "inf"]).unwrap().mask_m, Some(f64::INFINITY));
        let curved = parsed(&["--method", "minimum-curvature", "--tension", "0.5"]).unwrap();
        assert_eq!(curved.tension, 0.5);
    }

    #[test]
    fn gold_faults_name_flags() {
        let wrong = |args: &[&str]| parsed(args).err().unwrap();
        assert!(wrong(&["--spacing", "0"]).contains("`--spacing-m` must be above 0"), "{}", wrong(&["--spacing", "0"]));
        let tension = wrong(&["--tension", "0.5"]);
        assert!(tension.contains("`--tension` has no effect without `--method minimum_curvature`"), "{tension}");
        let word = wrong(&["--method", "kriging"]);
        assert!(word.contains("`--method` cannot be `kriging`"), "{word}");
        let bounds = wrong(&["--bounds", "1 2 3 4"]);
        assert!(bounds.contains("must be a list of numbers, not a list with the text `1 2 3 4`"), "{bounds}");
        assert!(bounds.contains("separate the values by commas"), "{bounds}");
    }
}
