//! Between this crate's types and OpenCV's; OpenCV's process-wide settings.

use std::sync::Once;

use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Size};
use opencv::{boxed_ref::BoxedRef, imgproc};

/// Makes every OpenCV call run on its caller's thread alone.
///
/// The server and the evaluation already run one image per worker thread. OpenCV's own pool would
/// only compete with them, and loops that collect their results under a lock (AKAZE) would return
/// them in an order that depends on timing. OpenCV keeps the number as an unguarded global, so it
/// is written once, before the first detector or resize runs.
pub(crate) fn use_one_thread_per_call() -> opencv::Result<()> {
    static SET: Once = Once::new();
    let mut outcome = Ok(());
    SET.call_once(|| outcome = opencv::core::set_num_threads(1));
    outcome
}

/// `pixels` (row-major, one byte each) as an OpenCV matrix over the same memory.
pub(crate) fn borrow_grey(width: u32, height: u32, pixels: &[u8]) -> opencv::Result<BoxedRef<'_, Mat>> {
    Mat::new_rows_cols_with_data(dimension(height)?, dimension(width)?, pixels)
}

/// Shrinks by area averaging (`INTER_AREA`); returns `width` x `height` pixels, row-major.
pub(crate) fn shrink(source: &BoxedRef<'_, Mat>, width: u32, height: u32) -> opencv::Result<Vec<u8>> {
    use_one_thread_per_call()?;
    let size = Size::new(dimension(width)?, dimension(height)?);
    let mut shrunk = Mat::default();
    imgproc::resize(source, &mut shrunk, size, 0.0, 0.0, imgproc::INTER_AREA)?;
    Ok(shrunk.data_bytes()?.to_vec())
}

/// The rows of a descriptor matrix of floats; none if the matrix is empty.
pub(crate) fn float_rows(matrix: &Mat) -> opencv::Result<Vec<&[f32]>> {
    (0..matrix.rows()).map(|row| matrix.at_row::<f32>(row)).collect()
}

/// The rows of a descriptor matrix of bytes; none if the matrix is empty.
pub(crate) fn byte_rows(matrix: &Mat) -> opencv::Result<Vec<&[u8]>> {
    (0..matrix.rows()).map(|row| matrix.at_row::<u8>(row)).collect()
}

fn dimension(pixels: u32) -> opencv::Result<i32> {
    i32::try_from(pixels).map_err(|_| {
        opencv::Error::new(opencv::core::StsOutOfRange, format!("a side of {pixels} pixels is out of range"))
    })
}
