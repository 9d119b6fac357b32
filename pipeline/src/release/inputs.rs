//! Input files of a run: named, hashed, and copied into the set on request.

use std::{
    fs,
    path::{Component, Path, PathBuf},
};

use plan::{
    PlanGraph,
    sources::walk,
    spec::{Spec, publish::ColumnRestriction},
};
use schemas::{Fault, keys::HashKey};

use super::{checksums, set::ReleaseInput, words::cannot};

/// Folder of the spec in a set.
pub const FOLDER: &str = "pipeline";

/// File that was read.
struct ReleaseSourceFile {
    table: String,
    path: PathBuf,
    /// Path from the spec's folder; `None` for an absolute path.
    relative: Option<Vec<String>>,
}

/// Spec and inputs of a set.
pub struct ReleaseInputs {
    /// Path of the spec in the set.
    pub spec: String,
    /// Files that were read.
    pub files: Vec<ReleaseInput>,
}

/// Parts of a path from the spec's folder, with `..` only at the front.
fn relative(folder: &Path, path: &Path) -> Option<Vec<String>> {
    // `Path` removes a `.` within a path, but not at its beginning.
    let plain = |p: &Path| p.components().filter(|c| *c != Component::CurDir).collect::<PathBuf>();
    let (folder, path) = (plain(folder), plain(path));
    let below = path.strip_prefix(&folder).ok()?;
    let mut parts: Vec<String> = vec![];
    for component in below.components() {
        match component {
            Component::Normal(name) => parts.push(name.to_str()?.to_owned()),
            Component::ParentDir => match parts.last() {
                Some(last) if last != ".." => {
                    parts.pop();
                }
                _ => parts.push("..".to_owned()),
            },
            Component::CurDir => {}
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(parts)
}

/// All files that a run reads, including the files for simulations.
fn all(graph: &PlanGraph) -> Result<Vec<ReleaseSourceFile>, Fault> {
    let plan = graph.plan;
    let mut found: Vec<ReleaseSourceFile> = vec![];
    let mut add = |table: &str, path: PathBuf| -> Result<(), Fault> {
        let mut files = vec![];
        if path.is_dir() {
            walk(&path, &mut files).map_err(|e| cannot("read", &path, &e))?;
        } else {
            files.push(path);
        }
        for path in files {
            if !found.iter().any(|f| f.path == path && f.table == table) {
                let relative = relative(&plan.spec.folder, &path);
                found.push(ReleaseSourceFile { table: table.to_owned(), path, relative });
            }
        }
        Ok(())
    };
    for flights in &plan.flights {
        for path in flights.inputs()? {
            add(&flights.name, path)?;
        }
    }
    for (map, bytes) in plan.maps.iter().zip(graph.bytes.iter().skip(plan.flights.len())) {
        for one in bytes {
            add(&map.name, one.path.clone())?;
        }
    }
    Ok(found)
}

/// Whether a table of the spec is restricted, wholly or in part.
fn is_restricted(spec: &Spec, table: &str) -> bool {
    spec.tables.iter().any(|t| t.name == table && t.protection.now() != ColumnRestriction::None)
}

/// Copies the spec, and with `include` the inputs, below `root`, and describes the inputs.
///
/// # Errors
/// Fails if an input has changed since it was read, must not be copied, or the file system reports an error.
pub fn gather(graph: &PlanGraph, root: &Path, include: bool, include_restricted: bool) -> Result<ReleaseInputs, Fault> {
    let spec = &graph.plan.spec;
    let files = all(graph)?;
    let place = if include { SpecFolder::new(spec, &files, include_restricted)? } else { SpecFolder::default() };
    let name = Path::new(&spec.file).file_name().and_then(|n| n.to_str());
    let name = name.ok_or_else(|| Fault::new(format!("the name of the spec {} is not valid UTF-8", spec.file)))?;
    let path = place.at(&[name.to_owned()]).ok_or_else(|| Fault::bug("the spec is outside the published set"))?;
    write(&root.join(&path), spec.text.as_bytes())?;
    let mut listed = vec![];
    for file in files {
        let shown = match &file.relative {
            Some(parts) => parts.join("/"),
            // Only the file name is shown, because an absolute path of this machine has no meaning elsewhere.
            None => file.path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
        };
        let included = if include { file.relative.as_ref().and_then(|parts| place.at(parts)) } else { None };
        if let Some(to) = &included {
            let to = root.join(to);
            if !to.exists() {
                let bytes = fs::read(&file.path).map_err(|e| cannot("read", &file.path, &e))?;
                write(&to, &bytes)?;
            }
        }
        let mut hasher = blake3::Hasher::new();
        // If the file was copied, the copy is hashed, so that the copy and its description agree.
        let from = included.as_ref().map_or(file.path.clone(), |to| root.join(to));
        let sum = checksums::of_file(&from, |read| {
            hasher.update(read);
        });
        let (bytes, sha256) = sum.map_err(|e| cannot("read", &from, &e))?;
        let hash = HashKey::finish(&hasher);
        let known = graph.bytes.iter().flatten().find(|b| b.path == file.path);
        if known.is_some_and(|known| known.hash != hash) {
            let what = format!("{} has changed since magline read it", file.path.display());
            return Err(Fault::machine(what).help(format!("run `magline run {}` again", spec.file)));
        }
        let ReleaseSourceFile { table, .. } = file;
        listed.push(ReleaseInput { table, file: shown, bytes, sha256, blake3: hash.to_string(), included });
    }
    Ok(ReleaseInputs { spec: path, files: listed })
}

fn write(to: &Path, bytes: &[u8]) -> Result<(), Fault> {
    let made = to.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(to, bytes));
    made.and_then(|()| fs::File::open(to)?.sync_all()).map_err(|e| cannot("write", to, &e))
}

/// Position of the spec's folder in a set, chosen so that the relative paths in the spec stay valid.
#[derive(Default)]
struct SpecFolder {
    /// Folders from the outermost one with an input to the folder of the spec.
    folders: Vec<String>,
}

impl SpecFolder {
    fn new(spec: &Spec, files: &[ReleaseSourceFile], include_restricted: bool) -> Result<SpecFolder, Fault> {
        const HELP: &str = "or remove `include_inputs`; the published set then lists the inputs with their hashes";
        let mut up = 0;
        for file in files {
            let Some(parts) = &file.relative else {
                let what = format!("`include_inputs`: {} has an absolute path", file.path.display());
                return Err(Fault::new(what).help(format!("use a path relative to the spec's folder, {HELP}")));
            };
            if is_restricted(spec, &file.table) && !include_restricted {
                let what = format!("`include_inputs`: the table `{}` is restricted", file.table);
                return Err(Fault::new(what)
                    .help(format!("use `--include-restricted` if you have the right to publish it, {HELP}")));
            }
            up = up.max(parts.iter().take_while(|p| *p == "..").count());
        }
        let full = fs::canonicalize(&spec.folder).map_err(|e| cannot("read", &spec.folder, &e))?;
        let names: Vec<String> = full
            .components()
            .filter_map(
                |c| if let Component::Normal(name) = c { Some(name.to_string_lossy().into_owned()) } else { None },
            )
            .collect();
        match names.len().checked_sub(up) {
            Some(from) => Ok(SpecFolder { folders: names.into_iter().skip(from).collect() }),
            None => Err(Fault::new("`include_inputs`: the path of an input leads above the root folder").help(HELP)),
        }
    }

    /// Path in the set of the file at `parts` from the spec's folder.
    fn at(&self, parts: &[String]) -> Option<String> {
        let mut all = self.folders.clone();
        for part in parts {
            if part == ".." {
                all.pop()?;
            } else {
                all.push(part.clone());
            }
        }
        Some(format!("{FOLDER}/{}", all.join("/")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_paths_are_relative_to_the_spec_folder() {
        let parts = |folder: &str, path: &str| relative(Path::new(folder), Path::new(path)).map(|p| p.join("/"));
        assert_eq!(parts("a/b", "a/b/../../c/d.tif").as_deref(), Some("../../c/d.tif"));
        assert_eq!(parts("a/b", "a/b/./x/../d.tif").as_deref(), Some("d.tif"));
        assert_eq!(parts(".", "./logs/1.csv").as_deref(), Some("logs/1.csv"));
        assert_eq!(parts("a/b", "/elsewhere/d.tif"), None);
        let place = SpecFolder { folders: vec!["datasets".into(), "examples".into()] };
        let at = |path: &str| place.at(&path.split('/').map(str::to_owned).collect::<Vec<_>>());
        assert_eq!(at("spec.toml").as_deref(), Some("pipeline/datasets/examples/spec.toml"));
        assert_eq!(at("../samples/d.tif").as_deref(), Some("pipeline/datasets/samples/d.tif"));
        assert_eq!(at("../../../d.tif"), None);
    }
}
