//! `magline man`: the manual pages.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use clap::{Args, Command, CommandFactory};
use clap_mangen::Man;
use schemas::Fault;

use super::{Cli, ExitReason, say};

#[derive(Args)]
pub struct ManArgs {
    /// The command, such as `run` or `map grid`; by default the page of `magline`.
    command: Vec<String>,
    /// Write the pages of all commands to this folder instead of printing one.
    #[arg(long, conflicts_with = "command")]
    to: Option<PathBuf>,
}

/// Prints a page, or writes all pages.
pub fn run(args: &ManArgs) -> Result<(), ExitReason> {
    let mut root = Cli::command();
    root.build();
    match &args.to {
        Some(folder) => write_all(&root, folder),
        None => print(&root, &args.command),
    }
}

fn print(root: &Command, names: &[String]) -> Result<(), ExitReason> {
    let mut found = root;
    let mut path = "magline".to_owned();
    for name in names {
        let known: Vec<&str> = visible(found).map(Command::get_name).collect();
        let Some(below) = visible(found).find(|c| c.get_name() == name) else {
            return Err(Fault::new(format!("`{path}` has no command `{name}`")).nearest(name, &known).into());
        };
        path = format!("{path} {name}");
        found = below;
    }
    say::out_text(String::from_utf8_lossy(&page(found)?));
    Ok(())
}

fn write_all(root: &Command, folder: &Path) -> Result<(), ExitReason> {
    let failed = |path: &Path, e: io::Error| ExitReason::Failed(format!("error: cannot write {}: {e}", path.display()));
    fs::create_dir_all(folder).map_err(|e| failed(folder, e))?;
    let mut open = vec![(root, "magline".to_owned())];
    while let Some((command, name)) = open.pop() {
        let path = folder.join(format!("{name}.1"));
        fs::write(&path, page(command)?).map_err(|e| failed(&path, e))?;
        open.extend(visible(command).map(|below| (below, format!("{name}-{}", below.get_name()))));
    }
    Ok(())
}

/// The commands that the help lists, without `help` itself.
fn visible(command: &Command) -> impl Iterator<Item = &Command> {
    command.get_subcommands().filter(|c| !c.is_hide_set() && c.get_name() != "help")
}

fn page(command: &Command) -> Result<Vec<u8>, ExitReason> {
    let mut page = vec![];
    let rendered = Man::new(command.clone()).render(&mut page);
    rendered.map_err(|e| ExitReason::Failed(format!("error: cannot write a manual page: {e}")))?;
    Ok(page)
}
