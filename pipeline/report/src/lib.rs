//! Views of a plan and of the results of its runs: the HTML report, SQL, explain, why, lineage, and the reference of
//! the stages. The views read the store and change nothing.

mod coast;
mod explain;
pub mod export;
pub mod html;
mod lineage;
pub mod openlineage;
mod reference;
mod schema;
mod series;
mod spectrum;
pub mod sql;
pub mod view;
mod why;

pub use explain::explain;
pub use lineage::{LineageFormat, lineage};
pub use reference::{one as stage_page, overview as stages_overview, page as reference_page};
pub use schema::schema as spec_schema;
pub use why::why;
