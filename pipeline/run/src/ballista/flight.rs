//! Serves the answers of a worker, which the scheduler fetches for a run. This is Ballista's file service, limited to
//! files of jobs.

use std::path::Path;

use arrow_flight::{
    Action, ActionType, Criteria, Empty, FlightData, FlightDescriptor, FlightInfo, HandshakeRequest, HandshakeResponse,
    PollInfo, PutResult, SchemaResult, Ticket, flight_service_server::FlightService,
};
use ballista_core::serde::{decode_protobuf, scheduler::Action as Fetch};
use ballista_executor::flight_service::BallistaFlightService;
use futures::stream::BoxStream;
use tonic::{Request, Response, Status, Streaming};

use super::closed::names_a_job;

/// Answers of tasks, as files in a folder.
pub struct AnswerFileService(BallistaFlightService);

type ArrowFlightResult<T> = Result<Response<T>, Status>;

/// Rejects requests for anything but the answers of a job.
fn check(bytes: &[u8]) -> Result<(), Status> {
    match decode_protobuf(bytes) {
        Ok(Fetch::FetchPartition { job_id, .. }) if names_a_job(job_id.as_str()) => Ok(()),
        Ok(_) => Err(Status::invalid_argument("the name of the job is invalid")),
        Err(_) => Err(Status::invalid_argument("the ticket does not identify a result of a task")),
    }
}

fn none<T>() -> ArrowFlightResult<T> {
    Err(Status::unimplemented("a worker serves only results of tasks"))
}

impl AnswerFileService {
    /// Service for the answers that tasks have written to `folder`.
    pub fn new(folder: &Path) -> AnswerFileService {
        AnswerFileService(BallistaFlightService::new(folder.display().to_string()))
    }
}

#[tonic::async_trait]
impl FlightService for AnswerFileService {
    type HandshakeStream = BoxStream<'static, Result<HandshakeResponse, Status>>;
    type ListFlightsStream = BoxStream<'static, Result<FlightInfo, Status>>;
    type DoGetStream = <BallistaFlightService as FlightService>::DoGetStream;
    type DoPutStream = BoxStream<'static, Result<PutResult, Status>>;
    type DoExchangeStream = BoxStream<'static, Result<FlightData, Status>>;
    type DoActionStream = <BallistaFlightService as FlightService>::DoActionStream;
    type ListActionsStream = BoxStream<'static, Result<ActionType, Status>>;

    async fn do_get(&self, request: Request<Ticket>) -> ArrowFlightResult<Self::DoGetStream> {
        check(&request.get_ref().ticket)?;
        self.0.do_get(request).await
    }

    async fn do_action(&self, request: Request<Action>) -> ArrowFlightResult<Self::DoActionStream> {
        check(&request.get_ref().body)?;
        self.0.do_action(request).await
    }

    async fn handshake(&self, _: Request<Streaming<HandshakeRequest>>) -> ArrowFlightResult<Self::HandshakeStream> {
        none()
    }

    async fn list_flights(&self, _: Request<Criteria>) -> ArrowFlightResult<Self::ListFlightsStream> {
        none()
    }

    async fn get_flight_info(&self, _: Request<FlightDescriptor>) -> ArrowFlightResult<FlightInfo> {
        none()
    }

    async fn poll_flight_info(&self, _: Request<FlightDescriptor>) -> ArrowFlightResult<PollInfo> {
        none()
    }

    async fn get_schema(&self, _: Request<FlightDescriptor>) -> ArrowFlightResult<SchemaResult> {
        none()
    }

    async fn do_put(&self, _: Request<Streaming<FlightData>>) -> ArrowFlightResult<Self::DoPutStream> {
        none()
    }

    async fn do_exchange(&self, _: Request<Streaming<FlightData>>) -> ArrowFlightResult<Self::DoExchangeStream> {
        none()
    }

    async fn list_actions(&self, _: Request<Empty>) -> ArrowFlightResult<Self::ListActionsStream> {
        none()
    }
}
