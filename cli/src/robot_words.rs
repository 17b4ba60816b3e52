//! `--words`: words are made here, as on a robot, and images stay here.

#[cfg(feature = "words")]
use std::path::PathBuf;

use clap::ValueEnum;
use waypost_client::{Client, FrameContent};

use crate::failure::Failure;
use crate::shrinking::fitting;

/// How words are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum WordForm {
    /// The word and the position of each feature
    Keypoints,
    /// How often each word occurs: the fewest bytes
    Histogram,
}

/// Whether words are sent.
#[derive(clap::Args, Default)]
pub(crate) struct Words {
    /// Send words instead of images; the map's model is downloaded once into the cache directory
    #[arg(
        long,
        value_enum,
        value_name = "FORM",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "keypoints"
    )]
    pub(crate) words: Option<WordForm>,
}

/// Makes the content of a frame from an image.
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
        Err(Failure::Unfit("this waypost cannot make words; build it with its default features".to_owned()))
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

    /// The hash that the session must declare.
    pub(crate) fn words_hash(&self) -> String {
        match self {
            ContentMaker::Images => String::new(),
            #[cfg(feature = "words")]
            ContentMaker::Words(maker, _) => maker.words_hash().to_owned(),
        }
    }

    /// The content of a frame with this image, made smaller if no server takes it. An image that
    /// gives no words is sent as it is, so that the server says what is wrong with it.
    pub(crate) async fn content(&self, image: Vec<u8>) -> FrameContent {
        let fitted = tokio::task::spawn_blocking(move || fitting(image)).await;
        let image = fitted.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
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

/// A model's file, from the cache or else from the server. The hash names the content, so a cached
/// file is never outdated; a damaged one is downloaded again.
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

/// Writes a file beside and renames it, so that another process never reads half of it.
#[cfg(feature = "words")]
async fn keep(path: &std::path::Path, file: &[u8]) -> std::io::Result<()> {
    if let Some(directory) = path.parent() {
        tokio::fs::create_dir_all(directory).await?;
    }
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    tokio::fs::write(&partial, file).await?;
    tokio::fs::rename(&partial, path).await
}

/// The cache of models, by the XDG base directories; none without a home directory.
#[cfg(feature = "words")]
fn cache_directory() -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let base = set("XDG_CACHE_HOME").or_else(|| set("HOME").map(|home| home.join(".cache")))?;
    Some(base.join("waypost/models"))
}
