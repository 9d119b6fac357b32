//! Licences by their SPDX identifiers.

use std::{io::Read, path::Path};

use plan::{sources, spec::publish::PublishFacts};
use schemas::{Fault, paths};

use super::set::{Licence, ReleaseMetadata};

/// Identifier, full name, and address of the text, of licences in use for data and code. [SPDX License List 3.27]
const KNOWN: [(&str, &str, &str); 24] = [
    ("0BSD", "BSD Zero Clause License", "https://opensource.org/license/0bsd"),
    ("Apache-2.0", "Apache License 2.0", "https://www.apache.org/licenses/LICENSE-2.0"),
    ("BSD-2-Clause", "BSD 2-Clause License", "https://opensource.org/license/bsd-2-clause"),
    ("BSD-3-Clause", "BSD 3-Clause License", "https://opensource.org/license/bsd-3-clause"),
    ("CC-BY-3.0", "Creative Commons Attribution 3.0", "https://creativecommons.org/licenses/by/3.0/"),
    ("CC-BY-4.0", "Creative Commons Attribution 4.0", "https://creativecommons.org/licenses/by/4.0/"),
    (
        "CC-BY-NC-4.0",
        "Creative Commons Attribution Non Commercial 4.0",
        "https://creativecommons.org/licenses/by-nc/4.0/",
    ),
    (
        "CC-BY-NC-ND-4.0",
        "Creative Commons Attribution Non Commercial No Derivatives 4.0",
        "https://creativecommons.org/licenses/by-nc-nd/4.0/",
    ),
    (
        "CC-BY-NC-SA-4.0",
        "Creative Commons Attribution Non Commercial Share Alike 4.0",
        "https://creativecommons.org/licenses/by-nc-sa/4.0/",
    ),
    (
        "CC-BY-ND-4.0",
        "Creative Commons Attribution No Derivatives 4.0",
        "https://creativecommons.org/licenses/by-nd/4.0/",
    ),
    ("CC-BY-SA-3.0", "Creative Commons Attribution Share Alike 3.0", "https://creativecommons.org/licenses/by-sa/3.0/"),
    ("CC-BY-SA-4.0", "Creative Commons Attribution Share Alike 4.0", "https://creativecommons.org/licenses/by-sa/4.0/"),
    ("CC0-1.0", "Creative Commons Zero 1.0", "https://creativecommons.org/publicdomain/zero/1.0/"),
    ("CDLA-Permissive-1.0", "Community Data License Agreement Permissive 1.0", "https://cdla.dev/permissive-1-0/"),
    ("CDLA-Permissive-2.0", "Community Data License Agreement Permissive 2.0", "https://cdla.dev/permissive-2-0/"),
    ("CDLA-Sharing-1.0", "Community Data License Agreement Sharing 1.0", "https://cdla.dev/sharing-1-0/"),
    (
        "GPL-3.0-or-later",
        "GNU General Public License 3.0 or later",
        "https://www.gnu.org/licenses/gpl-3.0-standalone.html",
    ),
    ("MIT", "MIT License", "https://opensource.org/license/mit"),
    ("MIT-0", "MIT No Attribution", "https://opensource.org/license/mit-0"),
    ("ODC-By-1.0", "Open Data Commons Attribution License 1.0", "https://opendatacommons.org/licenses/by/1-0/"),
    ("ODbL-1.0", "Open Data Commons Open Database License 1.0", "https://opendatacommons.org/licenses/odbl/1-0/"),
    (
        "OGL-UK-3.0",
        "Open Government Licence 3.0",
        "https://www.nationalarchives.gov.uk/doc/open-government-licence/version/3/",
    ),
    (
        "PDDL-1.0",
        "Open Data Commons Public Domain Dedication & License 1.0",
        "https://opendatacommons.org/licenses/pddl/1-0/",
    ),
    ("Unlicense", "The Unlicense", "https://unlicense.org/"),
];

/// Licence of the facts.
///
/// # Errors
/// Fails for an unknown name without an address.
pub fn from_facts(facts: &PublishFacts) -> Result<Licence, Fault> {
    let text = facts.licence_file.is_some();
    let name = facts.licence.clone();
    match (KNOWN.iter().find(|(id, ..)| *id == name), &facts.licence_url) {
        (Some((_, title, url)), given) => {
            let url = given.clone().unwrap_or_else(|| (*url).to_owned());
            Ok(Licence { name, title: (*title).to_owned(), url, spdx: true, text })
        }
        (None, Some(url)) => Ok(Licence { title: name.clone(), name, url: url.clone(), spdx: false, text }),
        (None, None) => {
            let known: Vec<&str> = KNOWN.iter().map(|(id, ..)| *id).collect();
            let fault = Fault::new(format!("the licence `{name}` is unknown")).nearest(&name, &known);
            let help = fault.help.clone().unwrap_or_default();
            Err(fault.help(format!("{help}; for another licence, add `licence_url`")))
        }
    }
}

/// Maximum size of the text of a licence, in bytes.
const LONGEST: u64 = 1 << 20;

/// Text of the licence in `file`, from the spec's folder `folder`. Because the text is published, the file must be
/// inside that folder and must not be reached by a link.
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
