//! The options of a `[tables.NAME]` of the spec in addition to its path.

use datasets::{FlightOptions, MapOptions};
use schemas::{Fault, Lists, Params, Reader};

use crate::spec::SourceDecl;

/// The options of a table of flights.
///
/// # Errors
/// Fails for unknown options and wrong types.
pub fn flight_options(decl: &SourceDecl) -> Result<FlightOptions, Vec<Fault>> {
    let options: FlightOptions = options(decl)?;
    if options.epsg.is_some() && options.format.as_deref() != Some("points") {
        let fault = Fault::new("`epsg` applies to survey points only: say `format = \"points\"`");
        return Err(vec![decl.options.get("epsg").into_iter().fold(fault, |fault, given| fault.at(given.at.clone()))]);
    }
    Ok(options)
}

/// The options of a map.
///
/// # Errors
/// Fails for unknown options and wrong types.
pub fn map_options(decl: &SourceDecl) -> Result<MapOptions, Vec<Fault>> {
    options(decl)
}

/// All options in one spelling, for keys.
pub fn spelt<T: Params>(options: &T) -> String {
    let mut pairs = vec![];
    options.spell(&mut pairs);
    pairs.iter().map(|(key, value)| format!("{key}={value};")).collect()
}

fn options<T: Params>(decl: &SourceDecl) -> Result<T, Vec<Fault>> {
    let lists = Lists::default();
    let mut reader = Reader::new(&decl.name, &decl.options, Some(decl.at.clone()), &lists);
    let options = T::read(&mut reader, None);
    let known: Vec<&str> = T::docs(&lists).iter().map(|doc| doc.name).collect();
    reader.unknown_keys(&known, &["path"]);
    let faults = reader.into_faults();
    options.filter(|_| faults.is_empty()).ok_or(faults)
}
