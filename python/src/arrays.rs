//! Takes arrays of numpy, and of whatever numpy takes, and gives numpy's.

use pyo3::buffer::{Element, PyBuffer};
use pyo3::prelude::*;

/// A number that arrays hold.
pub trait Number: Element {
    /// numpy's name of the type.
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

/// The values of an array, the last index fastest.
pub struct Array<T> {
    /// All of them.
    pub values: Vec<T>,
    /// The lengths along each index.
    pub shape: Vec<usize>,
}

/// Copies an array of `shape`, in which `None` is any length. Python converts what is not one: see `splatgraph/_arrays.py`.
///
/// # Errors
/// `TypeError` or `ValueError` with the argument's name.
pub fn take<T: Number>(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<Array<T>> {
    let py = value.py();
    let convert = py.import("splatgraph._arrays")?.getattr("array")?;
    let array = convert.call1((value, name, shape.to_vec(), T::NAME))?;
    let buffer = PyBuffer::<T>::get(&array)?;
    Ok(Array { values: buffer.to_vec(py)?, shape: buffer.shape().to_vec() })
}

/// Makes numpy's array of values.
///
/// # Errors
/// numpy's, such as `MemoryError`.
pub fn give<'py, T: Number>(py: Python<'py>, values: &[T], shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let array = py.import("numpy")?.call_method1("empty", (shape.to_vec(), T::NAME))?;
    PyBuffer::<T>::get(&array)?.copy_from_slice(py, values)?;
    Ok(array)
}
