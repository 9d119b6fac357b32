//! `magline completions`: a script that completes commands and options in a shell.

use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate};

use super::{Cli, ExitReason, say};

/// Instructions in the help.
pub const HELP: &str = "Installation:\n\n  bash: magline completions bash > \
                        ~/.local/share/bash-completion/completions/magline\n  zsh:  magline completions zsh > \
                        ~/.zfunc/_magline\n  fish: magline completions fish > ~/.config/fish/completions/magline.fish";

#[derive(Args)]
pub struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Prints the script.
pub fn run(args: &CompletionsArgs) -> Result<(), ExitReason> {
    let mut script = vec![];
    generate(args.shell, &mut Cli::command(), "magline", &mut script);
    say::out_text(String::from_utf8_lossy(&script));
    Ok(())
}
