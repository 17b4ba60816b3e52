//! `--words`: words are made here, on the robot, and images stay here.

use serde::Deserialize;
use waypost_client::{Client, Error, FrameContent};

/// How words are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum WordForm {
    /// The word and the position of each feature.
    Keypoints,
    /// How often each word occurs: the fewest bytes.
    Histogram,
}

/// Why a session is over, or cannot begin.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SessionError {
    /// The server refuses for good, or was lost.
    #[error(transparent)]
    Server(#[from] Error),
    /// The map's model makes no words here.
    #[error("words cannot be made for this map: {0}")]
    Words(String),
}

/// Makes the content of a frame from an image.
#[derive(Clone)]
pub(crate) enum ContentMaker {
    /// The image itself.
    Images,
    /// Words, by a map's model.
    #[cfg(feature = "words")]
    Words {
        maker: std::sync::Arc<waypost_client::words::WordMaker>,
        form: WordForm,
        /// The model's name, by which it is known again.
        model: String,
    },
}

impl ContentMaker {
    /// For a map; where the maker before is of the same model, that one. Else the model is downloaded.
    pub(crate) async fn for_map(
        self,
        client: &Client,
        map: &str,
        form: Option<WordForm>,
    ) -> Result<Self, SessionError> {
        match form {
            None => Ok(Self::Images),
            Some(form) => self.of_words(client, map, form).await,
        }
    }

    #[cfg(not(feature = "words"))]
    async fn of_words(self, _: &Client, _: &str, _: WordForm) -> Result<Self, SessionError> {
        Err(SessionError::Words(
            "this waypost-ros was built without them; build it with its default features".to_owned(),
        ))
    }

    #[cfg(feature = "words")]
    async fn of_words(self, client: &Client, map: &str, wanted: WordForm) -> Result<Self, SessionError> {
        let name = client.map(map, waypost_client::v1::MapView::Unspecified).await?.model;
        match self {
            Self::Words { maker, form, model } if model == name && form == wanted => {
                return Ok(Self::Words { maker, form, model });
            }
            Self::Words { .. } | Self::Images => {}
        }
        let mut file = Vec::new();
        client.export_model(&name, &mut file).await?;
        tracing::info!("{name} is here: {} bytes; words are made on the robot", file.len());
        let made = tokio::task::spawn_blocking(move || waypost_client::words::WordMaker::new(&file)).await;
        let made = made.map_err(|error| SessionError::Words(error.to_string()))?;
        let maker = made.map_err(|error| SessionError::Words(error.to_string()))?;
        Ok(Self::Words { maker: std::sync::Arc::new(maker), form: wanted, model: name })
    }

    /// The hash that the session must declare.
    pub(crate) fn words_hash(&self) -> String {
        match self {
            Self::Images => String::new(),
            #[cfg(feature = "words")]
            Self::Words { maker, .. } => maker.words_hash().to_owned(),
        }
    }

    /// The content of a frame with this image. Of one that gives no words there is nothing to send: why.
    pub(crate) async fn content(&self, image: Vec<u8>) -> Result<FrameContent, String> {
        match self.clone() {
            Self::Images => Ok(FrameContent::Image(image)),
            #[cfg(feature = "words")]
            Self::Words { maker, form, .. } => {
                let make = move || match form {
                    WordForm::Keypoints => maker.words(&image).map(FrameContent::Words),
                    WordForm::Histogram => maker.histogram(&image).map(FrameContent::Histogram),
                };
                let made = tokio::task::spawn_blocking(make).await.map_err(|error| error.to_string())?;
                made.map_err(|error| error.to_string())
            }
        }
    }
}
