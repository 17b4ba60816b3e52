//! Models beside the shipped one.

use std::io::Cursor;

use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use waypost_client::{Client, v1};

use super::reference;

/// The shipped model with a detector of its own: other decisions by the same words.
pub(crate) fn recalibrated_model(true_positive_rate: f64) -> Model {
    let detector = DetectorModel::new(true_positive_rate, 0.01).unwrap();
    remade(reference().model().extractor(), detector)
}

/// The shipped model as if its features were others: its words mean something else.
pub(crate) fn model_of_other_words() -> Model {
    let shipped = reference().model();
    let extractor = shipped.extractor().replace("features=500", "features=400");
    assert_ne!(extractor, shipped.extractor());
    remade(&extractor, *shipped.detector())
}

fn remade(extractor: &str, detector: DetectorModel) -> Model {
    let shipped = reference().model();
    let (vocabulary, tree) = (shipped.vocabulary().clone(), shipped.tree().clone());
    Model::new(extractor.to_owned(), vocabulary, tree, detector, shipped.sampling_set().to_vec()).unwrap()
}

/// Takes a model to a server.
pub(crate) async fn take_model(client: &Client, display_name: &str, model: &Model) -> v1::Model {
    client.import_model(display_name, Cursor::new(model.to_bytes())).await.unwrap()
}
