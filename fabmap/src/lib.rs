//! Where am I? Place recognition from appearance alone: FAB-MAP (Cummins & Newman).
//!
//! Pure: no I/O, no async, no pixels, no metres. Values are validated when they are made and
//! cannot fail after that. Begin with [`recognizer`], which tells the story.

pub mod appearance;
pub mod bail_out;
pub mod calibration;
pub mod chow_liu;
pub mod codec;
pub mod descriptor;
pub mod detector;
pub mod explanation;
pub mod inverted_index;
pub mod likelihood;
pub mod model;
pub mod new_place;
pub mod observation;
pub mod place_filter;
pub mod recognizer;
pub mod signature;
mod slices;
pub mod tf_idf;
pub mod vocabulary;

#[cfg(test)]
mod test_worlds;
