//! The options of a `[tables.NAME]` of the spec in addition to its path.

use std::{path::Path, sync::Arc};

use datasets::{FlightOptions, MapOptions};
use intake::{
    flight_formats,
    line_table::{FlightDivision, LineTable},
    mapping::{Mapping, MappingTable, detect::fitting, is_shown},
};
use schemas::{ChoiceRegistry, Fault, ParamReader, Params, params};

use super::files::{file, find};
use crate::spec::SourceDecl;

params! {
    /// The mapping and the lines of a log.
    pub struct MappingOptions, all default;
    /// Mapping of the columns: a TOML file, or the name of a built-in mapping such as `px4_ulog`. `auto` selects the
    /// built-in mapping that reads the largest part of the first log, and reports its name in a note. A mapping
    /// replaces `units` and `topic`. With a mapping, `rename` applies to the columns of the mapping.
    mapping: Option<String>, unit "", default None, absent "columns are identified by their names";
    /// Table of the mapping to read. A list declares several tables at once: in `[tables.log]`, `table = ["mag",
    /// "gps"]` declares `log_mag` and `log_gps`.
    table: Option<Vec<String>>, unit "", default None, absent "the only table";
    /// Table with the columns `flight`, `line`, `t_start` and `t_end` (in seconds past midnight UTC). It replaces the
    /// lines in the files. A sample belongs to the line that contains its time; samples outside all lines are dropped.
    /// `auto` finds the lines of each flight: straight lines and tie lines, calibration boxes, cloverleafs, figures of
    /// eight and circles. `magline ingest --lines auto --picture lines.svg` plots these lines and writes the table.
    lines: Option<String>, unit "", default None, absent "the lines of the files";
}

params! {
    /// The table of a model. The separate key `where` is an SQL condition on its columns that selects one model of
    /// several.
    pub struct ModelOptions, all default;
    /// Columns that the model requires in each line: the `features` of its fit.
    features: Vec<String>, unit "", default ["tl"].map(String::from);
}

/// Options for reading the files of a table.
pub struct FileOptions {
    /// Options for names, units and keys.
    pub options: FlightOptions,
    /// Mapping of the columns.
    pub mapped: Option<MappingTable>,
    /// Division of the flights into lines, if it differs from the lines in the file.
    pub lines: Option<FlightDivision>,
    /// Note for the user on the mapping that was chosen by content.
    pub note: Option<String>,
}

/// Value of `lines` and of `mapping` that selects detection.
pub const AUTO: &str = "auto";

/// Division by the table of lines `name`, or by detection.
///
/// # Errors
/// Returns the errors of [`LineTable::read`].
pub fn division(name: &str, folder: &Path) -> Result<FlightDivision, Fault> {
    if name == AUTO {
        Ok(FlightDivision::Found)
    } else {
        file(name, folder).and_then(|path| LineTable::read(&path)).map(FlightDivision::Table)
    }
}

/// Placeholder for the line identifier of a file that will be divided into lines.
pub const WHOLE: &str = "0";

/// The options of a table of flights, with its mapping table and its table of lines. Paths start from `folder`.
///
/// # Errors
/// Fails for unknown options, wrong types, or faults of the mapping.
pub fn flight_options(decl: &SourceDecl, folder: &Path) -> Result<FileOptions, Vec<Fault>> {
    let (mut options, MappingOptions { mapping, table, lines }) = options::<FlightOptions, MappingOptions>(decl)?;
    let option_of = |key: &str| decl.options.get(key);
    let at = |fault: Fault, key: &str| option_of(key).map_or(fault.clone(), |given| fault.at(given.at.clone()));
    if options.epsg.is_some() && options.format.as_deref() != Some("points") {
        let fault = Fault::new("`epsg` applies only to survey points; set `format = \"points\"`");
        return Err(vec![at(fault, "epsg")]);
    }
    let lines = lines.map(|name| division(&name, folder)).transpose();
    let lines = lines.map_err(|fault| vec![at(fault, "lines")])?;
    if lines.is_some() {
        // Files that will be divided need no line identifier.
        options.line.get_or_insert_with(|| WHOLE.to_owned());
    }
    let Some(name) = mapping else {
        let fault = || Fault::new("`table` requires `mapping`").help("set `mapping`, or remove `table`");
        return if table.is_some() {
            Err(vec![at(fault(), "table")])
        } else {
            Ok(FileOptions { options, mapped: None, lines, note: None })
        };
    };
    let taken: Vec<Fault> = ["units", "topic", "epsg"]
        .into_iter()
        .filter_map(|key| option_of(key).map(|given| (key, given)))
        .map(|(key, given)| {
            let fault = Fault::new(format!("`{key}` cannot be combined with `mapping`; set it in the mapping"));
            fault.at(given.key_at.clone())
        })
        .collect();
    if !taken.is_empty() {
        return Err(taken);
    }
    let (name, note) = if name == AUTO {
        chosen(decl, folder, &options).map_err(|fault| vec![at(fault, "mapping")])?
    } else {
        (name, None)
    };
    // A fault in a mapping is shown at its position in the mapping.
    let mapping = Mapping::load(&name, |name| file(name, folder))
        .map_err(|f| vec![if is_shown(&f) { f } else { at(f, "mapping") }])?;
    let key = if table.is_some() { "table" } else { "mapping" };
    let mapped =
        Arc::new(mapping).table(table.iter().flatten().map(String::as_str).next()).map_err(|f| vec![at(f, key)])?;
    Ok(FileOptions { options, mapped: Some(mapped), lines, note })
}

/// Name of the built-in mapping that can read the most tables in the first log of a declaration, and a note on the
/// choice.
fn chosen(decl: &SourceDecl, folder: &Path, options: &FlightOptions) -> Result<(String, Option<String>), Fault> {
    let logs = find(&decl.path.0, folder, options.format.is_some())?;
    let log = logs.first().ok_or_else(|| Fault::new(format!("there is no log in {}", decl.path.0)))?;
    let raw = FlightOptions { format: options.format.clone(), ..FlightOptions::default() };
    let fits = fitting(log, &raw, flight_formats()).map_err(Fault::from)?;
    let shown = log.file_name().unwrap_or_default().to_string_lossy();
    let Some(best) = fits.first() else {
        let fault = Fault::new(format!("no built-in mapping fits {shown}"));
        return Err(fault.help("`magline ingest --suggest LOG -o ours.toml` writes a mapping"));
    };
    let tables = best.tables.join(", ");
    let note =
        format!("`{}`: the mapping `{}` is chosen by the content of {shown}, and reads {tables}", decl.name, best.name);
    Ok((best.name.to_owned(), Some(note)))
}

/// The options of a map.
///
/// # Errors
/// Fails for unknown options and wrong types.
pub fn map_options(decl: &SourceDecl) -> Result<MapOptions, Vec<Fault>> {
    options::<MapOptions, NoKeys>(decl).map(|(options, _)| options)
}

/// The options of a model.
///
/// # Errors
/// Fails for unknown options and wrong types.
pub fn model_options(decl: &SourceDecl) -> Result<ModelOptions, Vec<Fault>> {
    options::<ModelOptions, NoKeys>(decl).map(|(options, _)| options)
}

params! {
    /// No keys.
    struct NoKeys, all default;
}

/// All options in canonical spelling, for keys.
pub fn spelt<T: Params>(options: &T) -> String {
    let mut pairs = vec![];
    options.spell(&mut pairs);
    pairs.iter().map(|(key, value)| format!("{key}={value};")).collect()
}

fn options<T: Params, U: Params>(decl: &SourceDecl) -> Result<(T, U), Vec<Fault>> {
    let lists = ChoiceRegistry::default();
    let mut reader = ParamReader::new(&decl.name, &decl.options, Some(decl.at.clone()), &lists);
    let options = T::read(&mut reader, None).zip(U::read(&mut reader, None));
    let known: Vec<&str> = T::docs(&lists).iter().chain(&U::docs(&lists)).map(|doc| doc.name).collect();
    reader.unknown_keys(&known, &["path"]);
    let faults = reader.into_faults();
    options.filter(|_| faults.is_empty()).ok_or(faults)
}
