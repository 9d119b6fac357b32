//! The tables of a store at one moment, and queries of these tables.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_schema::Schema;
use datafusion::{
    error::DataFusionError,
    execution::{
        SendableRecordBatchStream,
        disk_manager::{DiskManagerBuilder, DiskManagerMode},
        memory_pool::{FairSpillPool, MemoryConsumer, MemoryPool, MemoryReservation},
        runtime_env::RuntimeEnvBuilder,
    },
    logical_expr::LogicalPlan,
    prelude::{SQLOptions, SessionConfig, SessionContext},
};
use schemas::Fault;

use super::{
    explain, functions, refuse,
    tables::{self, QueryTables, VersionPins},
};

/// SQL session over the published tables of a store at the time of opening.
pub struct SqlSession {
    context: SessionContext,
    known: QueryTables,
    pool: Arc<dyn MemoryPool>,
    store: PathBuf,
    memory: usize,
}

impl SqlSession {
    /// Opens a session over the store in the folder `store`. The queries of the session share `memory` bytes, and spill
    /// to the folder `spill`.
    ///
    /// # Errors
    /// Fails if the store cannot be read.
    pub fn new(store: &Path, memory: usize, spill: &Path) -> Result<SqlSession, Fault> {
        SqlSession::at(store, memory, spill, None)
    }

    /// Session with the tables of the versions `pins`.
    ///
    /// # Errors
    /// Fails if the store cannot be read, or a version no longer exists.
    pub fn at(store: &Path, memory: usize, spill: &Path, pins: Option<&VersionPins>) -> Result<SqlSession, Fault> {
        let pool: Arc<dyn MemoryPool> = Arc::new(FairSpillPool::new(memory));
        let disk = DiskManagerBuilder::default().with_mode(DiskManagerMode::Directories(vec![spill.to_owned()]));
        let runtime = RuntimeEnvBuilder::new()
            .with_memory_pool(pool.clone())
            .with_disk_manager_builder(disk)
            .with_object_store_registry(Arc::new(tables::ClosedStoreRegistry))
            .build_arc()
            .map_err(|e| Fault::machine(e.to_string()))?;
        let context = SessionContext::new_with_config_rt(SessionConfig::new().with_information_schema(true), runtime);
        functions::register(&context);
        let known = tables::register(&context, store, pins)?;
        Ok(SqlSession { context, known, pool, store: store.to_owned(), memory })
    }

    /// Runs later queries in one partition. Several partitions mix the rows of different lines.
    pub fn use_one_partition(&self) {
        self.context.state_ref().write().config_mut().options_mut().execution.target_partitions = 1;
    }

    /// The plan of a read-only query; its parameters `$1`, `$2` may be unbound.
    ///
    /// # Errors
    /// Fails if the query is wrong, refers to an unknown table, or is not read-only.
    pub async fn plan(&self, query: &str) -> Result<LogicalPlan, Fault> {
        let wrong = |e: DataFusionError| self.fault(&e, query);
        let state = self.context.state();
        let statement = state.sql_to_statement(query, &state.config().options().sql_parser.dialect).map_err(wrong)?;
        refuse::statement(&statement)?;
        let plan = state.statement_to_plan(statement).await.map_err(wrong)?;
        refuse::plan(&plan)?;
        let nothing = SQLOptions::new().with_allow_ddl(false).with_allow_dml(false).with_allow_statements(false);
        nothing.verify_plan(&plan).map_err(wrong)?;
        Ok(plan)
    }

    /// The columns of the result of a plan without unbound parameters. Some types, such as the types of a union, are
    /// known only after analysis.
    ///
    /// # Errors
    /// Fails if the plan cannot be analysed.
    pub fn columns(&self, plan: &LogicalPlan) -> Result<Schema, DataFusionError> {
        Ok(self.context.state().optimize(plan)?.schema().as_arrow().clone())
    }

    /// The result of a plan, batch by batch.
    ///
    /// # Errors
    /// Fails if it cannot be started; see [`SqlSession::fault`].
    pub async fn run(&self, plan: LogicalPlan) -> Result<SendableRecordBatchStream, DataFusionError> {
        self.context.execute_logical_plan(plan).await?.execute_stream().await
    }

    /// Fault for an error of the query `query`.
    pub fn fault(&self, e: &DataFusionError, query: &str) -> Fault {
        explain::fault(e, self, query)
    }

    /// Memory for the processing of a result, counted with the memory of the queries.
    pub fn reserve(&self, name: &str) -> MemoryReservation {
        MemoryConsumer::new(name).register(&self.pool)
    }

    /// The available tables.
    pub fn known(&self) -> &QueryTables {
        &self.known
    }

    /// The versions of the tables.
    pub fn pins(&self) -> &VersionPins {
        &self.known.pins
    }

    /// DataFusion's own session.
    pub fn context(&self) -> &SessionContext {
        &self.context
    }

    /// The store's folder.
    pub fn store(&self) -> &Path {
        &self.store
    }

    /// Memory limit of the queries, in bytes.
    pub fn memory(&self) -> usize {
        self.memory
    }
}
