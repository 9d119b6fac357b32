//! `magline new`: a worked example with its data, in a new folder.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use clap::Args;
use results::text::columns;
use schemas::Fault;
use uuid::Uuid;

use super::{ExitReason, say, temporary::TemporaryFile};
use crate::shell::shell_word;

#[derive(Args)]
pub struct NewArgs {
    /// The example; without it, the examples are listed.
    example: Option<String>,
    /// The new folder; by default it has the name of the example.
    folder: Option<PathBuf>,
}

/// One example of `datasets/examples`.
struct Example {
    name: &'static str,
    about: &'static str,
    /// Specs and simulations, by their names.
    texts: &'static [(&'static str, &'static str)],
    /// Folders of `datasets/samples` that the example reads.
    samples: &'static [&'static Sample],
}

/// A folder of `datasets/samples`.
struct Sample {
    folder: &'static str,
    files: &'static [(&'static str, &'static [u8])],
}

macro_rules! texts {
    ($($name:literal),*) => {
        &[$(($name, include_str!(concat!("../../../datasets/examples/", $name)))),*]
    };
}

macro_rules! sample {
    ($folder:literal: $($name:literal),*) => {
        Sample {
            folder: $folder,
            files: &[$(($name, include_bytes!(concat!("../../../datasets/samples/", $folder, "/", $name)))),*],
        }
    };
}

static OSBORNE: Sample = sample!("osborne": "osborne_anomaly_100m_at_500m.tif", "MANIFEST.toml");
static SIMPLE_MAGNAV: Sample = sample!("simple_magnav": "xyz.h5", "map.h5", "MANIFEST.toml");
static MAGNAVJL_TL: Sample = sample!("magnavjl_tl": "magnavjl_tl.parquet", "MANIFEST.toml");
static THOR75: Sample = sample!("thor75": "flight.parquet", "MANIFEST.toml", "NOTICE.md");

/// The examples whose data are small enough to be part of the program.
static EXAMPLES: [Example; 9] = [
    Example {
        name: "osborne",
        about: "simulated flights over a real map: compensation and navigation with 27 combinations of settings",
        texts: texts!("osborne.toml", "magline-bench.synth.toml"),
        samples: &[&OSBORNE],
    },
    Example {
        name: "first_navigation",
        about: "navigation with the default settings",
        texts: texts!("first_navigation.toml", "first_navigation.synth.toml"),
        samples: &[&OSBORNE],
    },
    Example {
        name: "tolles_lawson",
        about: "Tolles-Lawson compensation of 1000 real samples, with a sweep of the ridge parameter",
        texts: texts!("tolles_lawson.toml"),
        samples: &[&MAGNAVJL_TL],
    },
    Example {
        name: "uav",
        about: "calibration of the only magnetometer of a small drone, with real data",
        texts: texts!("uav.toml", "uav_mapping.toml"),
        samples: &[&THOR75],
    },
    Example {
        name: "navigation",
        about: "navigation without compensation: the simple flight of MagNav.jl, and a simulated flight",
        texts: texts!("navigation.toml", "navigation.synth.toml"),
        samples: &[&OSBORNE, &SIMPLE_MAGNAV],
    },
    Example {
        name: "cold_start",
        about: "navigation without a calibration: the aircraft's field is estimated in flight",
        texts: texts!("cold_start.toml", "magline-bench.synth.toml"),
        samples: &[&OSBORNE],
    },
    Example {
        name: "search",
        about: "search for the model, penalty and frequency band of a compensation",
        texts: texts!("search.toml", "magline-bench.synth.toml"),
        samples: &[&OSBORNE],
    },
    Example {
        name: "map",
        about: "quality of a map before navigation",
        texts: texts!("map.toml", "osborne.synth.toml"),
        samples: &[&OSBORNE],
    },
    Example {
        name: "aids",
        about: "navigation with the difference of two magnetometers, in quiet conditions and in a magnetic storm",
        texts: texts!("aids.toml", "aids.synth.toml"),
        samples: &[&OSBORNE],
    },
];

/// Lists the examples, or writes one.
pub fn run(args: &NewArgs) -> Result<(), ExitReason> {
    let Some(name) = &args.example else {
        let rows: Vec<Vec<String>> = EXAMPLES.iter().map(|e| vec![e.name.to_owned(), e.about.to_owned()]).collect();
        say::out_text(columns(&rows, 2));
        say::out_text("\nnext: magline new osborne\n");
        return Ok(());
    };
    let names: Vec<&str> = EXAMPLES.iter().map(|e| e.name).collect();
    let Some(example) = EXAMPLES.iter().find(|e| e.name == name) else {
        let fault = Fault::new(format!("there is no example `{name}`")).nearest(name, &names);
        return Err(fault.into());
    };
    let folder = args.folder.clone().unwrap_or_else(|| example.name.into());
    if folder.symlink_metadata().is_ok() {
        let what = format!("{} exists and is not overwritten", folder.display());
        return Err(Fault::new(what).help(format!("give another folder: `magline new {name} FOLDER`")).into());
    }
    write(example, &folder)
        .map_err(|e| ExitReason::Failed(format!("error: cannot write {}: {e}", folder.display())))?;
    let spec = folder.join(format!("{name}.toml"));
    say::out_text(format!("{}: {}\n\n", folder.display(), example.about));
    for file in files(example) {
        say::out_text(format!("  {}\n", file.0.display()));
    }
    say::out_text(format!("\nnext: magline run {}\n", shell_word(&spec.to_string_lossy())));
    Ok(())
}

/// The files of an example, by their paths in its folder.
fn files(example: &Example) -> Vec<(PathBuf, Vec<u8>)> {
    let texts = example.texts.iter().map(|(name, text)| (PathBuf::from(name), adapted(text).into_bytes()));
    let data = example.samples.iter().flat_map(|sample| {
        sample.files.iter().map(|(name, bytes)| (Path::new("data").join(sample.folder).join(name), bytes.to_vec()))
    });
    texts.chain(data).collect()
}

/// Text of a file in `datasets/examples`, with the paths of the new folder.
fn adapted(text: &str) -> String {
    text.replace("../samples/", "data/").replace("datasets/examples/", "")
}

/// Writes a folder that does not exist. After an interrupt, the folder is either complete or absent.
fn write(example: &Example, folder: &Path) -> io::Result<()> {
    let parent = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent)?;
    let partial = TemporaryFile::new(parent.join(format!(".magline-{}", Uuid::new_v4())));
    for (path, bytes) in files(example) {
        let path = partial.path().join(path);
        fs::create_dir_all(path.parent().unwrap_or(partial.path()))?;
        fs::write(path, bytes)?;
    }
    fs::rename(partial.path(), folder)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn unit_every_file_that_an_example_names_is_in_its_folder() {
        for example in &EXAMPLES {
            let all = files(example);
            let names: BTreeSet<String> = all.iter().map(|(path, _)| path.display().to_string()).collect();
            assert!(names.contains(&format!("{}.toml", example.name)));
            for (name, text) in example.texts {
                let named = adapted(text);
                assert!(!named.contains("../"), "{name} leaves its folder");
                for line in named.lines() {
                    let Some((key, value)) = line.split_once('=') else { continue };
                    if ["path", "mapping"].contains(&key.trim()) {
                        assert!(names.contains(value.trim().trim_matches('"')), "{name}: {line}; {names:?}");
                    }
                }
            }
        }
    }
}
