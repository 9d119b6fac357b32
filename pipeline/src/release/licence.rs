//! The licence of a published set.

use std::{io::Read, path::Path};

use plan::{
    sources,
    spec::{licences::LICENCES, publish::PublishFacts},
};
use schemas::{Fault, paths};

use super::set::{Licence, ReleaseMetadata};

/// Licence of the facts.
///
/// # Errors
/// Fails for an unknown name without an address.
pub fn from_facts(facts: &PublishFacts) -> Result<Licence, Fault> {
    let text = facts.licence_file.is_some();
    let name = facts.licence.clone();
    match (LICENCES.iter().find(|(id, ..)| *id == name), &facts.licence_url) {
        (Some((_, title, url)), given) => {
            let url = given.clone().unwrap_or_else(|| (*url).to_owned());
            Ok(Licence { name, title: (*title).to_owned(), url, spdx: true, text })
        }
        (None, Some(url)) => Ok(Licence { title: name.clone(), name, url: url.clone(), spdx: false, text }),
        (None, None) => {
            let known: Vec<&str> = LICENCES.iter().map(|(id, ..)| *id).collect();
            let fault = Fault::new(format!("the licence `{name}` is unknown")).nearest(&name, &known);
            let help = fault.help.clone().unwrap_or_default();
            Err(fault.help(format!("{help}; for another licence, add `licence_url`")))
        }
    }
}

/// Maximum size of the text of a licence, in bytes.
const LONGEST: u64 = 1 << 20;

/// Text of the licence in `file`, a path relative to the spec's folder `folder`. Because the text is published, the
/// file must be inside that folder and must not be reached by a link.
///
/// # Errors
/// Fails for a path that leads out of the folder, or for a file that is missing, too large, or not text.
pub fn text(file: &str, folder: &Path) -> Result<String, Fault> {
    let wrong = |why: &str| Fault::new(format!("`licence_file`: {file}: {why}"));
    let help = "copy the licence to the spec's folder, and give its path in that folder";
    let path = if file.contains("://") {
        sources::file(file, folder)?
    } else {
        paths::check_path(file).map_err(|why| wrong(&why).help(help))?;
        let path = folder.join(file);
        paths::check_no_link(folder, &path).map_err(|e| wrong(&e.to_string()).help(help))?;
        path
    };
    let opened = paths::open_regular(&path).map_err(|e| wrong(&e.to_string()))?;
    let mut text = String::new();
    let read = opened.take(LONGEST + 1).read_to_string(&mut text).map_err(|e| wrong(&e.to_string()))?;
    if read as u64 > LONGEST {
        return Err(wrong(&format!("it is longer than {LONGEST} bytes")));
    }
    Ok(text)
}

/// File `LICENSE` without the text of the licence: holder, title, and address of the text.
pub fn write(about: &ReleaseMetadata) -> String {
    let names: Vec<&str> = about.authors.iter().map(|a| a.name.as_str()).collect();
    let year = about.date.get(..4).unwrap_or_default();
    let Licence { name, title, url, .. } = &about.licence;
    let named = if title == name { name.clone() } else { format!("{title} ({name})") };
    format!(
        "{}\nCopyright {year} {}\n\nThis data set is licensed under\n{named}.\nIts text is at {url}\n",
        about.title,
        names.join(", ")
    )
}
