use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::correction_service_server::CorrectionService;

use super::Adapter;
use super::reach::{within, within_by};
use crate::pages::Page;
use crate::wire::corrections::correction;

#[tonic::async_trait]
impl CorrectionService for Adapter {
    async fn withdraw_loop_closure(
        &self,
        request: Request<v1::WithdrawLoopClosureRequest>,
    ) -> Result<Response<v1::Correction>, Status> {
        let (caller, v1::WithdrawLoopClosureRequest { frame }) = within_by(request)?;
        Ok(Response::new(correction(self.service.correcting.withdraw(&caller, &frame).await?)))
    }

    async fn confirm_loop_closure(
        &self,
        request: Request<v1::ConfirmLoopClosureRequest>,
    ) -> Result<Response<v1::Correction>, Status> {
        let (caller, v1::ConfirmLoopClosureRequest { frame, matched_frame }) = within_by(request)?;
        let confirmed = self.service.correcting.confirm(&caller, &frame, &matched_frame).await?;
        Ok(Response::new(correction(confirmed)))
    }

    async fn undo_correction(
        &self,
        request: Request<v1::UndoCorrectionRequest>,
    ) -> Result<Response<v1::Correction>, Status> {
        let (caller, v1::UndoCorrectionRequest { name }) = within_by(request)?;
        Ok(Response::new(correction(self.service.correcting.undo(&caller, &name).await?)))
    }

    async fn list_corrections(
        &self,
        request: Request<v1::ListCorrectionsRequest>,
    ) -> Result<Response<v1::ListCorrectionsResponse>, Status> {
        let v1::ListCorrectionsRequest { map, page_size, page_token } = within(request)?;
        let Page { items, next } = self.service.correcting.list(&map, page_size, &page_token).await?;
        let corrections = items.into_iter().map(correction).collect();
        Ok(Response::new(v1::ListCorrectionsResponse { corrections, next_page_token: next }))
    }
}
