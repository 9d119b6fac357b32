//! Plan under construction.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use schemas::{Fault, StageEntry, Table};

use super::{RecordedPlan, TableNode, node::InputTarget};
use crate::{
    predicate::Predicate,
    sources::{Flights, MapSource},
    spec::Spec,
};

/// Maximum number of faults of a stage; with more faults, the other points of the stage are not checked.
pub const MOST_FAULTS: usize = 20;

/// Role in which a stage uses a table of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TableUse {
    /// Flight lines.
    Flights,
    /// A map.
    Map,
    /// A model.
    Model,
}

/// A plan under construction.
pub struct PlanBuilder<'a> {
    pub spec: &'a Spec,
    pub catalogue: &'a [StageEntry],
    /// Recorded facts of the inputs, which then need not be read.
    pub recorded: Option<&'a RecordedPlan>,
    pub faults: Vec<Fault>,
    pub flights: Vec<Flights>,
    /// Schemas of the tables in `flights`, as stages see them.
    pub shapes: Vec<Arc<Table>>,
    pub maps: Vec<MapSource>,
    /// Schemas of a map without and with the error of each node.
    pub map_shapes: [Arc<Table>; 2],
    /// Schemas of the maps in `maps`, as stages see them.
    pub wholes: Vec<Arc<Table>>,
    /// Opened tables of files, by name and use; `None` if a file could not be opened.
    pub sources: BTreeMap<(String, TableUse), Option<InputTarget>>,
    pub tables: Vec<TableNode>,
    /// Names of faulty stages. Of the stages that depend on them, only the parameters are checked.
    pub broken: Vec<String>,
    pub notes: Vec<String>,
    /// Parsed predicates, by their text and the columns that they can use. Most points of a sweep share one predicate.
    pub predicates: HashMap<(String, Option<*const Table>), Arc<Predicate>>,
}

impl<'a> PlanBuilder<'a> {
    /// Creates an empty plan.
    pub fn new(spec: &'a Spec, catalogue: &'a [StageEntry], recorded: Option<&'a RecordedPlan>) -> Self {
        PlanBuilder {
            spec,
            catalogue,
            recorded,
            faults: vec![],
            flights: vec![],
            shapes: vec![],
            maps: vec![],
            map_shapes: [schemas::map::shape(), schemas::map::shape_with_error()]
                .map(|shape| Arc::new(Table::Map(shape))),
            wholes: vec![],
            sources: BTreeMap::new(),
            tables: vec![],
            broken: vec![],
            notes: vec![],
            predicates: HashMap::new(),
        }
    }
}
