//! Every call of the contract, by what it is about. All are methods of [`Client`](crate::Client).

mod appearance;
mod cluster;
mod corrections;
pub(crate) mod events;
pub(crate) mod jobs;
mod labels;
mod maps;
mod merges;
mod models;
mod navigations;
mod sessions;
mod snapshots;
mod tokens;
mod transfer;

#[cfg(test)]
mod tests {
    use crate::client::Client;
    use crate::error::Error;

    #[tokio::test]
    async fn calls_can_be_spawned() {
        let spawnable = |_: &(dyn Future<Output = Result<(), Error>> + Send)| {};
        let client = Client::lazy("http://127.0.0.1:1").unwrap();
        spawnable(&async { client.models().await.map(drop) });
        spawnable(&async { client.maps().await.map(drop) });
        spawnable(&async { client.places("drive").await.map(drop) });
        spawnable(&async { client.loop_closures("drive").await.map(drop) });
        spawnable(&async { client.word_places("drive", 7).await.map(drop) });
        spawnable(&async { client.sessions("drive").await.map(drop) });
        spawnable(&async { client.frames("maps/drive/sessions/robot").await.map(drop) });
    }
}
