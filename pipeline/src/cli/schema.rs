//! `magline schema`: the JSON Schema of a spec, for editors.

use report::spec_schema;
use schemas::StageEntry;

use super::{ExitReason, say};

/// Instructions in the help.
pub const HELP: &str = "Editors with TOML support, such as VS Code with Even Better TOML, then complete and check the \
                        keys of a spec:\n\n  magline schema > magline.schema.json\n\nand in the first line of the \
                        spec:\n\n  #:schema ./magline.schema.json";

/// Prints the schema.
pub fn run(catalogue: &[StageEntry]) -> Result<(), ExitReason> {
    say::out_text(format!("{:#}\n", spec_schema(catalogue)));
    Ok(())
}
