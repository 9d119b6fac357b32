//! Flight SQL over the queries of a store: catalogue, statements, prepared statements. All writes are rejected.

use std::{pin::Pin, sync::Arc};

use arrow_array::RecordBatch;
use arrow_flight::{
    Action, FlightData, FlightDescriptor, FlightEndpoint, FlightInfo, HandshakeRequest, HandshakeResponse, IpcMessage,
    SchemaAsIpc, Ticket,
    decode::FlightRecordBatchStream,
    encode::FlightDataEncoderBuilder,
    error::FlightError,
    sql::{
        ActionClosePreparedStatementRequest, ActionCreatePreparedStatementRequest, ActionCreatePreparedStatementResult,
        CommandGetCatalogs, CommandGetCrossReference, CommandGetDbSchemas, CommandGetExportedKeys,
        CommandGetImportedKeys, CommandGetPrimaryKeys, CommandGetSqlInfo, CommandGetTableTypes, CommandGetTables,
        CommandGetXdbcTypeInfo, CommandPreparedStatementQuery, CommandPreparedStatementUpdate, CommandStatementIngest,
        CommandStatementQuery, CommandStatementUpdate, DoPutPreparedStatementResult, Nullable, ProstMessageExt,
        Searchable, SqlInfo, TicketStatementQuery, XdbcDataType,
        metadata::{SqlInfoData, SqlInfoDataBuilder, XdbcTypeInfo, XdbcTypeInfoData, XdbcTypeInfoDataBuilder},
        server::{FlightSqlService, PeekableFlightDataStream},
    },
};
use arrow_ipc::writer::IpcWriteOptions;
use arrow_schema::{ArrowError, Schema, SchemaRef};
use datafusion::common::TableReference;
use futures::{Stream, StreamExt, TryStreamExt, stream};
use prost::Message;
use tonic::{Request, Response, Status, Streaming};

use super::{
    Token, keys, parameters,
    queries::{PlannedQuery, QueryRegistry, fault_status},
};

/// Name of the catalogue that holds all pipelines, as in `datafusion.PIPELINE.TABLE`.
const CATALOG: &str = "datafusion";
const TABLE: &str = "TABLE";

type FlightDataResponse = Response<Pin<Box<dyn Stream<Item = Result<FlightData, Status>> + Send>>>;

/// Flight SQL service of a store.
pub struct StoreQueryService {
    queries: QueryRegistry,
    token: Option<Token>,
}

fn broken(e: &dyn std::fmt::Display) -> Status {
    Status::internal(e.to_string())
}

fn refused() -> Status {
    Status::permission_denied("rejected: the store is read-only; use SELECT")
}

/// Flight information for fetching the rows of `ticket`.
fn info(request: Request<FlightDescriptor>, schema: &Schema, ticket: Vec<u8>) -> Result<Response<FlightInfo>, Status> {
    let endpoint = FlightEndpoint::new().with_ticket(Ticket { ticket: ticket.into() });
    let info = FlightInfo::new().try_with_schema(schema).map_err(|e| broken(&e))?;
    Ok(Response::new(info.with_endpoint(endpoint).with_descriptor(request.into_inner())))
}

fn encoded(
    schema: SchemaRef,
    rows: impl Stream<Item = Result<RecordBatch, FlightError>> + Send + 'static,
) -> FlightDataResponse {
    let data = FlightDataEncoderBuilder::new().with_schema(schema).build(rows);
    Response::new(Box::pin(data.map_err(Status::from)))
}

/// Answer of one batch.
fn one(batch: Result<RecordBatch, ArrowError>) -> Result<FlightDataResponse, Status> {
    let batch = batch.map_err(|e| broken(&e))?;
    Ok(encoded(batch.schema(), stream::iter([Ok(batch)])))
}

fn flight(batch: Result<RecordBatch, FlightError>) -> Result<FlightDataResponse, Status> {
    one(batch.map_err(|e| ArrowError::ExternalError(Box::new(e))))
}

fn spelt(schema: &Schema) -> Result<bytes::Bytes, Status> {
    let options = IpcWriteOptions::default();
    let message: Result<IpcMessage, ArrowError> = SchemaAsIpc::new(schema, &options).try_into();
    message.map(|IpcMessage(bytes)| bytes).map_err(|e| broken(&e))
}

/// Description of this server.
fn sql_info() -> Result<SqlInfoData, Status> {
    let mut about = SqlInfoDataBuilder::new();
    about.append(SqlInfo::FlightSqlServerName, "magline");
    about.append(SqlInfo::FlightSqlServerVersion, env!("CARGO_PKG_VERSION"));
    about.append(SqlInfo::FlightSqlServerArrowVersion, "1.5");
    about.append(SqlInfo::FlightSqlServerReadOnly, true);
    about.append(SqlInfo::FlightSqlServerSql, true);
    about.append(SqlInfo::FlightSqlServerSubstrait, false);
    // No transactions: see SqlSupportedTransaction.
    about.append(SqlInfo::FlightSqlServerTransaction, 0_i32);
    about.append(SqlInfo::FlightSqlServerCancel, false);
    about.append(SqlInfo::SqlIdentifierQuoteChar, "\"");
    about.build().map_err(|e| broken(&e))
}

/// Types of columns.
fn types() -> Result<XdbcTypeInfoData, Status> {
    let mut all = XdbcTypeInfoDataBuilder::new();
    let kinds = [
        ("VARCHAR", XdbcDataType::XdbcVarchar, None),
        ("DOUBLE", XdbcDataType::XdbcDouble, Some(53)),
        ("BIGINT", XdbcDataType::XdbcBigint, Some(64)),
        ("BOOLEAN", XdbcDataType::XdbcBit, None),
    ];
    for (name, data_type, size) in kinds {
        let quote = (data_type == XdbcDataType::XdbcVarchar).then(|| "'".to_owned());
        all.append(XdbcTypeInfo {
            type_name: name.to_owned(),
            data_type,
            column_size: size,
            literal_prefix: quote.clone(),
            literal_suffix: quote,
            create_params: None,
            nullable: Nullable::NullabilityNullable,
            case_sensitive: data_type == XdbcDataType::XdbcVarchar,
            searchable: Searchable::Full,
            unsigned_attribute: size.map(|_| false),
            fixed_prec_scale: false,
            auto_increment: None,
            local_type_name: Some(name.to_owned()),
            minimum_scale: None,
            maximum_scale: None,
            sql_data_type: data_type,
            datetime_subcode: None,
            num_prec_radix: size.map(|_| 2),
            interval_precision: None,
        });
    }
    all.build().map_err(|e| broken(&e))
}

impl StoreQueryService {
    /// Service for these queries. A client that sends the token receives it back from a handshake.
    pub fn new(queries: QueryRegistry, token: Option<Token>) -> StoreQueryService {
        StoreQueryService { queries, token }
    }

    /// Pipeline, name and columns of each requested table.
    async fn tables(
        &self,
        with_columns: bool,
        asked: impl Fn(&str, &str) -> bool + Send,
    ) -> Result<Vec<(String, String, SchemaRef)>, Status> {
        let session = self.queries.session().await?;
        let mut found = vec![];
        for name in &session.known().tables {
            let Some((pipeline, table)) = name.split_once('.').filter(|(p, t)| asked(p, t)) else { continue };
            let mut schema = Arc::new(Schema::empty());
            if with_columns {
                let provider = session.context().table_provider(TableReference::partial(pipeline, table)).await;
                schema = provider.map_err(|e| fault_status(&session.fault(&e, "")))?.schema();
            }
            found.push((pipeline.to_owned(), table.to_owned(), schema));
        }
        Ok(found)
    }

    async fn keys_of(&self, query: &CommandGetPrimaryKeys) -> Result<RecordBatch, Status> {
        let there = query.catalog.as_deref().is_none_or(|c| c == CATALOG);
        let schema = query.db_schema.as_deref();
        let is_asked = |p: &str, t: &str| there && t == query.table && schema.is_none_or(|s| s == p);
        let mut batches = vec![];
        for (pipeline, table, schema) in &self.tables(true, is_asked).await? {
            let columns = keys::primary(schema);
            batches.push(keys::primary_batch(CATALOG, pipeline, table, &columns).map_err(|e| broken(&e))?);
        }
        arrow_select::concat::concat_batches(&keys::primary_schema(), &batches).map_err(|e| broken(&e))
    }

    async fn answer(&self, planned: Arc<PlannedQuery>) -> Result<FlightDataResponse, Status> {
        let schema = planned.schema.clone();
        Ok(encoded(schema, self.queries.answer(planned).await?))
    }

    fn ticket(
        &self,
        planned: Arc<PlannedQuery>,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let schema = planned.schema.clone();
        let ticket = TicketStatementQuery { statement_handle: self.queries.keep(planned).into() };
        info(request, &schema, ticket.as_any().encode_to_vec())
    }
}

#[tonic::async_trait]
impl FlightSqlService for StoreQueryService {
    type FlightService = StoreQueryService;

    async fn do_handshake(
        &self,
        _: Request<Streaming<HandshakeRequest>>,
    ) -> Result<Response<Pin<Box<dyn Stream<Item = Result<HandshakeResponse, Status>> + Send>>>, Status> {
        // Requests without the correct token are rejected earlier.
        let answer = HandshakeResponse { protocol_version: 0, payload: Default::default() };
        let mut response: Response<Pin<Box<dyn Stream<Item = _> + Send>>> =
            Response::new(Box::pin(stream::iter([Ok(answer)])));
        if let Some(token) = &self.token {
            let header = token.bearer().parse().map_err(|_| Status::internal("the token is not a valid header"))?;
            response.metadata_mut().insert("authorization", header);
        }
        Ok(response)
    }

    async fn get_flight_info_statement(
        &self,
        query: CommandStatementQuery,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let planned = self.queries.plan(query.query, None).await?;
        self.queries.bound(&planned)?;
        self.ticket(planned, request)
    }

    async fn get_flight_info_prepared_statement(
        &self,
        query: CommandPreparedStatementQuery,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let (query, parameters) = self.queries.prepared(&query.prepared_statement_handle)?;
        let planned = self.queries.plan(query, parameters).await?;
        self.ticket(planned, request)
    }

    async fn do_get_statement(
        &self,
        ticket: TicketStatementQuery,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        self.answer(self.queries.planned(&ticket.statement_handle)?).await
    }

    async fn do_get_prepared_statement(
        &self,
        query: CommandPreparedStatementQuery,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        let (query, parameters) = self.queries.prepared(&query.prepared_statement_handle)?;
        self.answer(self.queries.plan(query, parameters).await?).await
    }

    async fn do_action_create_prepared_statement(
        &self,
        query: ActionCreatePreparedStatementRequest,
        _: Request<Action>,
    ) -> Result<ActionCreatePreparedStatementResult, Status> {
        let query = parameters::numbered(&query.query).map_err(|fault| fault_status(&fault))?;
        let planned = self.queries.plan(query.clone(), None).await?;
        Ok(ActionCreatePreparedStatementResult {
            prepared_statement_handle: self.queries.prepare(query).into(),
            dataset_schema: spelt(&planned.schema)?,
            parameter_schema: spelt(&planned.parameters)?,
        })
    }

    async fn do_action_close_prepared_statement(
        &self,
        query: ActionClosePreparedStatementRequest,
        _: Request<Action>,
    ) -> Result<(), Status> {
        self.queries.close(&query.prepared_statement_handle);
        Ok(())
    }

    async fn do_put_prepared_statement_query(
        &self,
        query: CommandPreparedStatementQuery,
        request: Request<PeekableFlightDataStream>,
    ) -> Result<DoPutPreparedStatementResult, Status> {
        /// A statement takes one row of values, so reading stops at the second row.
        const ROWS: usize = 2;
        let data = request.into_inner().map_err(FlightError::from);
        let mut rows = FlightRecordBatchStream::new_from_flight_data(data);
        let mut batches: Vec<RecordBatch> = vec![];
        while let Some(batch) = rows.next().await {
            let batch = batch.map_err(Status::from)?;
            if batch.num_rows() > 0 {
                batches.push(batch);
            }
            if batches.iter().map(RecordBatch::num_rows).sum::<usize>() >= ROWS {
                break;
            }
        }
        let schema = batches.first().map_or_else(|| Arc::new(Schema::empty()), RecordBatch::schema);
        let all = arrow_select::concat::concat_batches(&schema, &batches).map_err(|e| broken(&e))?;
        self.queries.bind(&query.prepared_statement_handle, all)?;
        let same = Some(query.prepared_statement_handle);
        Ok(DoPutPreparedStatementResult { prepared_statement_handle: same })
    }

    async fn get_flight_info_catalogs(
        &self,
        query: CommandGetCatalogs,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let ticket = query.as_any().encode_to_vec();
        info(request, &query.into_builder().schema(), ticket)
    }

    async fn do_get_catalogs(
        &self,
        query: CommandGetCatalogs,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        let mut all = query.into_builder();
        all.append(CATALOG);
        flight(all.build())
    }

    async fn get_flight_info_schemas(
        &self,
        query: CommandGetDbSchemas,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let ticket = query.as_any().encode_to_vec();
        info(request, &query.into_builder().schema(), ticket)
    }

    async fn do_get_schemas(
        &self,
        query: CommandGetDbSchemas,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        let mut all = query.into_builder();
        let mut pipelines: Vec<String> =
            self.tables(false, |_, _| true).await?.into_iter().map(|(pipeline, ..)| pipeline).collect();
        pipelines.dedup();
        pipelines.iter().for_each(|pipeline| all.append(CATALOG, pipeline));
        flight(all.build())
    }

    async fn get_flight_info_tables(
        &self,
        query: CommandGetTables,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let ticket = query.as_any().encode_to_vec();
        info(request, &query.into_builder().schema(), ticket)
    }

    async fn do_get_tables(&self, query: CommandGetTables, _: Request<Ticket>) -> Result<FlightDataResponse, Status> {
        let mut all = query.into_builder();
        for (pipeline, table, schema) in self.tables(all.include_schema(), |_, _| true).await? {
            all.append(CATALOG, pipeline, table, TABLE, &schema).map_err(Status::from)?;
        }
        flight(all.build())
    }

    async fn get_flight_info_table_types(
        &self,
        query: CommandGetTableTypes,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let ticket = query.as_any().encode_to_vec();
        info(request, &query.into_builder().schema(), ticket)
    }

    async fn do_get_table_types(
        &self,
        query: CommandGetTableTypes,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        let mut all = query.into_builder();
        all.append(TABLE);
        flight(all.build())
    }

    async fn get_flight_info_sql_info(
        &self,
        query: CommandGetSqlInfo,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let ticket = query.as_any().encode_to_vec();
        info(request, &query.into_builder(&sql_info()?).schema(), ticket)
    }

    async fn do_get_sql_info(
        &self,
        query: CommandGetSqlInfo,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        flight(query.into_builder(&sql_info()?).build())
    }

    async fn get_flight_info_xdbc_type_info(
        &self,
        query: CommandGetXdbcTypeInfo,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        let ticket = query.as_any().encode_to_vec();
        info(request, &query.into_builder(&types()?).schema(), ticket)
    }

    async fn do_get_xdbc_type_info(
        &self,
        query: CommandGetXdbcTypeInfo,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        flight(query.into_builder(&types()?).build())
    }

    async fn get_flight_info_primary_keys(
        &self,
        query: CommandGetPrimaryKeys,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        info(request, &keys::primary_schema(), query.as_any().encode_to_vec())
    }

    async fn do_get_primary_keys(
        &self,
        query: CommandGetPrimaryKeys,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        one(Ok(self.keys_of(&query).await?))
    }

    async fn get_flight_info_exported_keys(
        &self,
        query: CommandGetExportedKeys,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        info(request, &keys::foreign_schema(), query.as_any().encode_to_vec())
    }

    async fn do_get_exported_keys(
        &self,
        _: CommandGetExportedKeys,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        one(Ok(RecordBatch::new_empty(keys::foreign_schema())))
    }

    async fn get_flight_info_imported_keys(
        &self,
        query: CommandGetImportedKeys,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        info(request, &keys::foreign_schema(), query.as_any().encode_to_vec())
    }

    async fn do_get_imported_keys(
        &self,
        _: CommandGetImportedKeys,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        one(Ok(RecordBatch::new_empty(keys::foreign_schema())))
    }

    async fn get_flight_info_cross_reference(
        &self,
        query: CommandGetCrossReference,
        request: Request<FlightDescriptor>,
    ) -> Result<Response<FlightInfo>, Status> {
        info(request, &keys::foreign_schema(), query.as_any().encode_to_vec())
    }

    async fn do_get_cross_reference(
        &self,
        _: CommandGetCrossReference,
        _: Request<Ticket>,
    ) -> Result<FlightDataResponse, Status> {
        one(Ok(RecordBatch::new_empty(keys::foreign_schema())))
    }

    async fn do_put_statement_update(
        &self,
        _: CommandStatementUpdate,
        _: Request<PeekableFlightDataStream>,
    ) -> Result<i64, Status> {
        Err(refused())
    }

    async fn do_put_statement_ingest(
        &self,
        _: CommandStatementIngest,
        _: Request<PeekableFlightDataStream>,
    ) -> Result<i64, Status> {
        Err(refused())
    }

    async fn do_put_prepared_statement_update(
        &self,
        _: CommandPreparedStatementUpdate,
        _: Request<PeekableFlightDataStream>,
    ) -> Result<i64, Status> {
        Err(refused())
    }

    async fn register_sql_info(&self, _: i32, _: &SqlInfo) {}
}
