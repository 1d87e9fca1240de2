//! Compares and encodes pictures.

use crate::arrays::take;
use crate::errors;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use splatgraph::io::image::Image;
use splatgraph::studies::metrics;

/// Measures the difference between two pictures, float32 [height, width, 3], display-encoded, with 0 for black and 1
/// for white.
///
/// Returns: A dict: psnr_db (dB, None for an error of 0), ssim (1 for equal pictures, None below 11 x 11 pixels), worst
/// (difference, x, y) and identical.
///
/// Raises:
///     ValueError: the pictures differ in size, or a value is not finite.
#[pyfunction]
pub fn compare<'py>(a: &Bound<'py, PyAny>, b: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let py = a.py();
    let (a, b) = (picture(a, "a")?, picture(b, "b")?);
    let comparison =
        py.detach(|| metrics::compare(&a, &b)).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let json = serde_json::to_string(&comparison).map_err(|e| PyValueError::new_err(e.to_string()))?;
    errors::from_json(py, &json)
}

/// Encodes a picture, float32 [height, width, 3], display-encoded, as the bytes of an 8-bit PNG file.
#[pyfunction]
pub fn png<'py>(picture: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
    let py = picture.py();
    let image = self::picture(picture, "picture")?;
    let bytes = py.detach(|| image.png()).map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(PyBytes::new(py, &bytes))
}

fn picture(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Image> {
    let array = take::<f32>(value, name, &[None, None, Some(3)])?;
    let (height, width) = (array.shape[0], array.shape[1]);
    let rgb = array.values.as_chunks::<3>().0.to_vec();
    Ok(Image { width, height, rgb })
}
