//! Several tables of one log in one declaration.

use std::collections::HashSet;

use schemas::{Fault, Literal, paths};

use super::SourceDecl;

/// The tables of all declarations. Faults are appended to `faults`.
pub fn tables(declared: Vec<SourceDecl>, faults: &mut Vec<Fault>) -> Vec<SourceDecl> {
    let mut all: Vec<SourceDecl> = vec![];
    for decl in declared {
        match spread(decl) {
            Ok(more) => all.extend(more),
            Err(fault) => faults.push(fault),
        }
    }
    let mut names = HashSet::new();
    if let Some(twice) = all.iter().find(|decl| !names.insert(decl.name.as_str())) {
        let fault = Fault::new(format!("two tables would have the name `{}`", twice.name)).at(twice.at.clone());
        faults.push(fault.help("rename one of the two tables"));
    }
    all
}

/// The tables of a declaration: the declaration itself, or a table `NAME_TABLE` for each entry of a list `table`.
///
/// # Errors
/// Fails for an entry that is not the name of a table, or for two equal entries.
fn spread(decl: SourceDecl) -> Result<Vec<SourceDecl>, Fault> {
    let Some(entry) = decl.options.get("table") else { return Ok(vec![decl]) };
    let Literal::List(items) = &entry.value else { return Ok(vec![decl]) };
    let at = |fault: Fault| fault.at(entry.at.clone());
    let mut names: Vec<&str> = vec![];
    for item in items {
        let name = item.as_text().filter(|name| paths::check_name(&format!("{}_{name}", decl.name)).is_ok());
        let Some(name) = name else {
            let what = format!("`{item}` in `table` is not the name of a table of the mapping");
            return Err(at(Fault::new(what)));
        };
        if names.contains(&name) {
            return Err(at(Fault::new(format!("`table` lists `{name}` twice"))));
        }
        names.push(name);
    }
    if names.is_empty() {
        return Err(at(Fault::new("`table` is empty").help("list only tables of the mapping, or remove `table`")));
    }
    let one = |name: &str| {
        let mut own = SourceDecl { name: format!("{}_{name}", decl.name), ..decl.clone() };
        own.options.entry("table".to_owned()).and_modify(|given| given.value = Literal::Text(name.to_owned()));
        own
    };
    Ok(names.into_iter().map(one).collect())
}
