//! `--words`: words made here, as a robot would, so that images stay here.

#[cfg(feature = "words")]
use std::path::PathBuf;

use clap::ValueEnum;
use waypost_client::{Client, FrameContent};

use crate::failure::Failure;

/// What of the words is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum WordForm {
    /// The word of each feature and where it is
    Keypoints,
    /// How often each word was seen: the fewest bytes
    Histogram,
}

/// Makes of an image what is sent of it.
#[derive(Clone)]
pub(crate) enum ContentMaker {
    Images,
    #[cfg(feature = "words")]
    Words(std::sync::Arc<waypost_client::words::WordMaker>, WordForm),
}

impl ContentMaker {
    /// For a map: downloads its model unless it was downloaded before.
    pub(crate) async fn new(client: &Client, map: &str, words: Option<WordForm>) -> Result<Self, Failure> {
        match words {
            None => Ok(ContentMaker::Images),
            Some(form) => Self::of_words(client, map, form).await,
        }
    }

    #[cfg(not(feature = "words"))]
    async fn of_words(_: &Client, _: &str, _: WordForm) -> Result<Self, Failure> {
        Err(Failure::Unfit(
            "this waypost cannot make words; build it with `--features waypost-client/words`".to_owned(),
        ))
    }

    #[cfg(feature = "words")]
    async fn of_words(client: &Client, map: &str, form: WordForm) -> Result<Self, Failure> {
        let map = client.map(map, waypost_client::v1::MapView::Unspecified).await?;
        let hash = map.model.rsplit('/').next().unwrap_or_default().to_owned();
        let file = model_file(client, &hash).await?;
        let made = tokio::task::spawn_blocking(move || waypost_client::words::WordMaker::new(&file)).await;
        let maker = made.map_err(|error| Failure::Unfit(error.to_string()))?;
        let maker = maker.map_err(|error| Failure::Unfit(error.to_string()))?;
        Ok(ContentMaker::Words(std::sync::Arc::new(maker), form))
    }

    /// What the session must declare.
    pub(crate) fn words_hash(&self) -> String {
        match self {
            ContentMaker::Images => String::new(),
            #[cfg(feature = "words")]
            ContentMaker::Words(maker, _) => maker.words_hash().to_owned(),
        }
    }

    /// What is sent of an image. One that no words can be made of goes as it is: the server says what is
    /// wrong with it.
    pub(crate) async fn content(&self, image: Vec<u8>) -> FrameContent {
        match self.clone() {
            ContentMaker::Images => FrameContent::Image(image),
            #[cfg(feature = "words")]
            ContentMaker::Words(maker, form) => {
                let make = move || {
                    let made = match form {
                        WordForm::Keypoints => maker.words(&image).map(FrameContent::Words),
                        WordForm::Histogram => maker.histogram(&image).map(FrameContent::Histogram),
                    };
                    made.unwrap_or(FrameContent::Image(image))
                };
                let made = tokio::task::spawn_blocking(make).await;
                made.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()))
            }
        }
    }
}

/// A model's file, from the cache or else from the server. A hash names its content, so that a cached file
/// is never out of date; one that is damaged is downloaded again.
#[cfg(feature = "words")]
async fn model_file(client: &Client, hash: &str) -> Result<Vec<u8>, Failure> {
    let cached = cache_directory().map(|directory| directory.join(format!("{hash}.waypost")));
    if let Some(path) = &cached
        && let Ok(file) = tokio::fs::read(path).await
        && fabmap::model::Model::from_bytes(&file).is_ok_and(|model| model.hash().to_string() == hash)
    {
        return Ok(file);
    }
    let mut file = Vec::new();
    client.export_model(&format!("models/{hash}"), &mut file).await?;
    if let Some(path) = &cached {
        keep(path, &file).await.map_err(Failure::file("write", path))?;
    }
    Ok(file)
}

/// Written beside and renamed, so that two that start at once never read half a file.
#[cfg(feature = "words")]
async fn keep(path: &std::path::Path, file: &[u8]) -> std::io::Result<()> {
    if let Some(directory) = path.parent() {
        tokio::fs::create_dir_all(directory).await?;
    }
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    tokio::fs::write(&partial, file).await?;
    tokio::fs::rename(&partial, path).await
}

/// Where models are kept between runs, by the XDG base directories; nowhere if there is no home.
#[cfg(feature = "words")]
fn cache_directory() -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let base = set("XDG_CACHE_HOME").or_else(|| set("HOME").map(|home| home.join(".cache")))?;
    Some(base.join("waypost/models"))
}
