//! `magline view`: a page of a store for the browser.

use clap::Args;
use schemas::StageEntry;

use super::ExitReason;

/// The arguments of a view.
#[derive(Args)]
#[cfg_attr(not(feature = "serve"), allow(dead_code, reason = "only the feature `serve` reads the fields"))]
pub struct ViewArgs {
    /// The spec, whose runs are shown as they progress; or the store's folder or address such as s3://BUCKET/PREFIX. By
    /// default the folder `store` here or in the folder above.
    #[arg(value_name = "SPEC|STORE")]
    source: Option<String>,
    /// The port on this machine; 0 selects a free port.
    #[arg(long, value_name = "N", default_value_t = 0)]
    port: u16,
    /// Override a value of the spec, as in `magline run`.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "source")]
    sets: Vec<String>,
}

/// Serves until it is interrupted.
#[cfg(not(feature = "serve"))]
pub fn run(_: &[StageEntry], _: &ViewArgs) -> Result<(), ExitReason> {
    Err(super::serve::without_serve())
}

/// Serves until it is interrupted. Nothing is written, so an interrupt ends the process at once.
#[cfg(feature = "serve")]
pub fn run(catalogue: &[StageEntry], args: &ViewArgs) -> Result<(), ExitReason> {
    use std::path::Path;

    use ::view::ViewedSpec;
    use report::view::RunProgress;
    use schemas::Fault;

    use super::{SpecArgs, explain::with_graph, interrupt, say::err, temporary, tend};

    let _ = ctrlc::set_handler(|| {
        temporary::remove_all();
        std::process::exit(i32::from(interrupt::STATUS))
    });
    let folder = temporary::TemporaryFolder::new()?;
    let settings = ::view::ViewSettings {
        port: args.port,
        program: super::engine::program()?,
        temporary: folder.path().to_owned(),
    };
    let started = |address: &str| err!("{address}");
    // A view does not create a store.
    let has_store = |folder: &Path, help: &str| -> Result<(), Fault> {
        store::pulled(folder)?;
        let missing = || Fault::new(format!("{} is not a store", store::shown(folder))).help(help);
        tend::is_store(folder).then_some(()).ok_or_else(missing)
    };
    let is_spec = |text: &&String| text.ends_with(".toml") || Path::new(text).is_file();
    if let Some(spec) = args.source.as_ref().filter(is_spec) {
        let spec = SpecArgs { spec: spec.into(), sets: args.sets.clone() };
        let read = plan::read_spec(&spec.spec, &spec.sets)?;
        has_store(&read.store, &format!("run the spec first: `magline run {}`", read.file))?;
        let viewed = ViewedSpec { pipeline: &read.name, file: &read.file };
        let plan = |serve: &dyn Fn(&RunProgress)| -> Result<(), ExitReason> {
            with_graph(catalogue, &spec, |graph, store| {
                serve(&RunProgress::new(graph, store));
                Ok(String::new())
            })
        };
        return settings.serve_spec(catalogue, (&read.store, &viewed), Box::new(plan), started);
    }
    let given = args.source.as_deref().map(super::located).transpose().map_err(Fault::new)?;
    let store = tend::found_store(given.as_deref());
    has_store(&store, "run a spec first, then give the spec, or its store")?;
    Ok(settings.serve_store(catalogue, &store, started)?)
}
