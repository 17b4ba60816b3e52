use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::merge_service_server::MergeService;

use super::Adapter;
use super::reach::with_caller;
use crate::pages::Page;
use crate::service::merges::{CommitPolicy, MergeRequest};
use crate::wire::merges::merge;

#[tonic::async_trait]
impl MergeService for Adapter {
    async fn merge_maps(
        &self,
        request: Request<v1::MergeMapsRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let (caller, message) = with_caller(request)?;
        let v1::MergeMapsRequest { sources, target, auto_commit, min_support } = message;
        let commit_policy = if auto_commit { CommitPolicy::Automatic } else { CommitPolicy::OnRequest };
        let request = MergeRequest { sources, target, commit_policy, min_support };
        Ok(Response::new(merge(self.service.merges.begin(&caller, request).await?)))
    }

    async fn get_merge(&self, request: Request<v1::GetMergeRequest>) -> Result<Response<v1::Merge>, Status> {
        let (caller, v1::GetMergeRequest { name }) = with_caller(request)?;
        Ok(Response::new(merge(self.service.merges.get(&caller, &name).await?)))
    }

    async fn list_merges(
        &self,
        request: Request<v1::ListMergesRequest>,
    ) -> Result<Response<v1::ListMergesResponse>, Status> {
        let (caller, v1::ListMergesRequest { page_size, page_token }) = with_caller(request)?;
        let Page { items, next } = self.service.merges.list(&caller, page_size, &page_token).await?;
        let merges = items.into_iter().map(merge).collect();
        Ok(Response::new(v1::ListMergesResponse { merges, next_page_token: next }))
    }

    async fn get_merge_picture(
        &self,
        request: Request<v1::GetMergePictureRequest>,
    ) -> Result<Response<v1::GetMergePictureResponse>, Status> {
        let (caller, v1::GetMergePictureRequest { name }) = with_caller(request)?;
        let picture = self.service.merges.picture(&caller, &name).await?.into_bytes();
        let content_type = "image/svg+xml".to_owned();
        Ok(Response::new(v1::GetMergePictureResponse { content_type, picture }))
    }

    async fn commit_merge(
        &self,
        request: Request<v1::CommitMergeRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let (caller, v1::CommitMergeRequest { name }) = with_caller(request)?;
        Ok(Response::new(merge(self.service.merges.commit(&caller, &name).await?)))
    }

    async fn discard_merge(
        &self,
        request: Request<v1::DiscardMergeRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let (caller, v1::DiscardMergeRequest { name }) = with_caller(request)?;
        Ok(Response::new(merge(self.service.merges.discard(&caller, &name).await?)))
    }

    async fn undo_merge(
        &self,
        request: Request<v1::UndoMergeRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let (caller, v1::UndoMergeRequest { name }) = with_caller(request)?;
        Ok(Response::new(merge(self.service.merges.undo(&caller, &name).await?)))
    }
}
