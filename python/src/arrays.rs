//! Converts numpy arrays, and objects that numpy converts, to Rust values, and back.

use pyo3::buffer::{Element, PyBuffer};
use pyo3::prelude::*;
use splatgraph::io::image::Image;

pub trait Number: Element {
    /// Name of the type in numpy.
    const NAME: &str;
}

impl Number for f32 {
    const NAME: &str = "float32";
}

impl Number for u32 {
    const NAME: &str = "uint32";
}

impl Number for f64 {
    const NAME: &str = "float64";
}

/// A copy of an array.
pub struct Array<T> {
    /// Values in row-major order.
    pub values: Vec<T>,
    /// Length of each dimension.
    pub shape: Vec<usize>,
}

/// Copies an array of `shape`, in which `None` is any length. `splatgraph/_arrays.py` converts the objects of other
/// libraries, and other types of numbers.
///
/// # Errors
/// `TypeError` if `value` is no array of numbers, and `ValueError` for another shape, an array on a device, or an array
/// with gradients. The message has the argument's name.
pub fn take<T: Number>(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<Array<T>> {
    let py = value.py();
    let convert = py.import("splatgraph._arrays")?.getattr("array")?;
    let array = convert.call1((value, name, shape.to_vec(), T::NAME))?;
    let buffer = PyBuffer::<T>::get(&array)?;
    Ok(Array { values: buffer.to_vec(py)?, shape: buffer.shape().to_vec() })
}

/// Copies a picture [height, width, 3] as floats, with 1 for white. `size` is the required width and height, or `None`.
///
/// # Errors
/// Those of [`take`], `TypeError` for integers other than uint8 and uint16, and `ValueError` for floats that are 8-bit
/// values.
pub fn take_picture(value: &Bound<'_, PyAny>, name: &str, size: Option<(usize, usize)>) -> PyResult<Image> {
    let py = value.py();
    let convert = py.import("splatgraph._arrays")?.getattr("picture")?;
    let array = convert.call1((value, name, [size.map(|size| size.1), size.map(|size| size.0), Some(3)]))?;
    let buffer = PyBuffer::<f32>::get(&array)?;
    let (height, width) = (buffer.shape()[0], buffer.shape()[1]);
    Ok(Image { width, height, rgb: buffer.to_vec(py)?.as_chunks::<3>().0.to_vec() })
}

/// Copies row-major values to a new numpy array.
///
/// # Errors
/// Errors of numpy, such as `MemoryError`.
pub fn give<'py, T: Number>(py: Python<'py>, values: &[T], shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let array = py.import("numpy")?.call_method1("empty", (shape.to_vec(), T::NAME))?;
    PyBuffer::<T>::get(&array)?.copy_from_slice(py, values)?;
    Ok(array)
}
