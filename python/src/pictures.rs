//! Compares and encodes pictures.

use crate::arrays::take_picture;
use crate::{errors, wait};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::json;
use splatgraph_reference::metrics;

/// Measures the difference between two pictures [height, width, 3], display-encoded: floats with 0 for black and 1 for
/// white, uint8 or uint16.
///
/// Returns: A dict: psnr_db (dB, "inf" for an error of 0), ssim (1 for equal pictures, None below 11 x 11 pixels),
/// worst (difference, x, y) and identical.
///
/// Raises:
///     ValueError: the pictures differ in size, or a value is not finite.
#[pyfunction]
pub fn compare<'py>(a: &Bound<'py, PyAny>, b: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let py = a.py();
    let (a, b) = (take_picture(a, "a", None)?, take_picture(b, "b", None)?);
    wait::pool()?;
    let comparison = py
        .detach(|| metrics::compare((&a).into(), (&b).into()))
        .map_err(|e| PyValueError::new_err(e.to_string()))?;
    errors::to_python(py, &json!(comparison))
}

/// Encodes a display-encoded picture [height, width, 3] of floats, uint8 or uint16 as the bytes of an 8-bit PNG file.
#[pyfunction]
pub fn png<'py>(picture: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
    let py = picture.py();
    let image = take_picture(picture, "picture", None)?;
    let bytes = py.detach(|| image.png()).map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(PyBytes::new(py, &bytes))
}
