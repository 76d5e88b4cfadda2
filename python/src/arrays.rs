//! NumPy arrays from values of the library and back. Results stay where they are: an array that shows them keeps them alive
//! (NumPy's array interface). Arguments are copied once, into what the library keeps.

use crate::errors::invalid;
use antirad::glam::DVec3;
use pyo3::buffer::{Element, PyBuffer};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};
use std::sync::Arc;

/// An array.
pub type Array<'py> = Bound<'py, PyAny>;

/// The numbers of an array, and what keeps them alive.
#[pyclass(frozen, module = "antirad")]
pub struct Memory {
    address: usize,
    shape: Vec<usize>,
    /// NumPy's name of the type of a number.
    kind: &'static str,
    writable: bool,
    _owner: Owner,
}

/// Never read: it keeps the numbers where they are.
#[expect(dead_code, reason = "held for their memory")]
enum Owner {
    F32(Vec<f32>),
    F64(Vec<f64>),
    I64(Vec<i64>),
    Bool(Vec<bool>),
    Rows(Arc<Vec<[f64; 3]>>),
}

/// Types of numbers that arrays hold.
pub trait Number: Copy {
    /// NumPy's name of the type.
    const KIND: &'static str;
    /// A vector of them as an owner.
    #[expect(private_interfaces, reason = "within this module")]
    fn owner(values: Vec<Self>) -> Owner;
}

macro_rules! numbers {
    ($($type:ty, $kind:literal, $owner:ident;)+) => {
        $(impl Number for $type {
            const KIND: &'static str = $kind;
            #[expect(private_interfaces, reason = "within this module")]
            fn owner(values: Vec<Self>) -> Owner {
                Owner::$owner(values)
            }
        })+
    };
}

numbers! {
    f32, "=f4", F32;
    f64, "=f8", F64;
    i64, "=i8", I64;
    bool, "|b1", Bool;
}

#[pymethods]
impl Memory {
    /// What `numpy.asarray` asks for.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = [("version", 3)].into_py_dict(py)?;
        interface.set_item("shape", pyo3::types::PyTuple::new(py, &self.shape)?)?;
        let order = if cfg!(target_endian = "little") { "<" } else { ">" };
        interface.set_item("typestr", self.kind.replace('=', order))?;
        interface.set_item("data", (self.address, !self.writable))?;
        Ok(interface)
    }
}

fn shown_by(py: Python<'_>, memory: Memory) -> PyResult<Array<'_>> {
    py.import("numpy")?.call_method1("asarray", (memory,))
}

/// An array of a shape that holds the numbers.
pub fn array<'py, T: Number>(py: Python<'py>, mut values: Vec<T>, shape: &[usize]) -> PyResult<Array<'py>> {
    let address = values.as_mut_ptr().expose_provenance();
    let memory =
        Memory { address, shape: shape.to_vec(), kind: T::KIND, writable: true, _owner: T::owner(values) };
    shown_by(py, memory)
}

/// An array [rows, 3].
pub fn rows<T: Number>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Array<'_>> {
    let shape = [rows.len(), 3];
    array(py, rows.into_flattened(), &shape)
}

/// An array [rows, 3].
pub fn points(py: Python<'_>, points: Vec<DVec3>) -> PyResult<Array<'_>> {
    rows::<f64>(py, bytemuck::allocation::cast_vec(points))
}

/// An array [rows].
pub fn vector<T: Number>(py: Python<'_>, values: Vec<T>) -> PyResult<Array<'_>> {
    let shape = [values.len()];
    array(py, values, &shape)
}

/// An array [rows] of indices, in the type that NumPy and PyTorch index with.
pub fn indices<'py>(py: Python<'py>, indices: &[u32]) -> PyResult<Array<'py>> {
    vector(py, indices.iter().copied().map(i64::from).collect())
}

/// A picture [height, width, 3].
pub fn picture<T: Number>(py: Python<'_>, pixels: Vec<[T; 3]>, width: u32) -> PyResult<Array<'_>> {
    let width = width as usize;
    let height = pixels.len() / width.max(1);
    array(py, pixels.into_flattened(), &[height, width, 3])
}

/// Values of a solution, which must not be written to.
pub fn of_solution<'py>(py: Python<'py>, rows: &Arc<Vec<[f64; 3]>>) -> PyResult<Array<'py>> {
    let memory = Memory {
        address: rows.as_ptr().expose_provenance(),
        shape: vec![rows.len(), 3],
        kind: f64::KIND,
        writable: false,
        _owner: Owner::Rows(rows.clone()),
    };
    shown_by(py, memory)
}

/// An argument: anything that NumPy turns into an array of this type of numbers.
pub struct Numbers<T = f64> {
    /// Row by row.
    pub values: Vec<T>,
    pub shape: Vec<usize>,
}

impl<T: Element> Numbers<T> {
    fn copied(array: &Bound<PyAny>) -> PyResult<Self> {
        let buffer = PyBuffer::<T>::get(array)?;
        Ok(Self { values: buffer.to_vec(array.py())?, shape: buffer.shape().to_vec() })
    }
}

impl<'py> FromPyObject<'_, 'py> for Numbers<f64> {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let arguments = [("dtype", "float64"), ("order", "C")].into_py_dict(given.py())?;
        Self::copied(&given.py().import("numpy")?.call_method("asarray", (given,), Some(&arguments))?)
    }
}

impl<'py> FromPyObject<'_, 'py> for Numbers<i64> {
    type Error = PyErr;

    /// Refuses fractions.
    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let arguments = [("casting", "same_kind"), ("order", "C")].into_py_dict(given.py())?;
        let array = given.py().import("numpy")?.call_method1("asarray", (given,))?;
        Self::copied(&array.call_method("astype", ("int64",), Some(&arguments))?)
    }
}

/// Rows of three from an array [count, 3]. `what` is its name in messages.
pub fn triples<T: Copy>(what: &str, numbers: &Numbers<T>, count: Option<usize>) -> PyResult<Vec<[T; 3]>> {
    match *numbers.shape {
        [given, 3] if count.is_none_or(|count| count == given) => Ok(numbers.values.as_chunks().0.to_vec()),
        ref shape => {
            let wanted = count.map_or_else(|| String::from("n"), |count| count.to_string());
            Err(invalid(format!("{what} has the shape {}; it must be ({wanted}, 3)", shown(shape))))
        }
    }
}

/// Points from an array [count, 3].
pub fn vectors(what: &str, numbers: &Numbers, count: Option<usize>) -> PyResult<Vec<DVec3>> {
    Ok(bytemuck::allocation::cast_vec(triples(what, numbers, count)?))
}

/// Numbers from an array [count].
pub fn scalars<T: Copy>(what: &str, numbers: &Numbers<T>, count: usize) -> PyResult<Vec<T>> {
    match *numbers.shape {
        [given] if given == count => Ok(numbers.values.clone()),
        ref shape => Err(invalid(format!("{what} has the shape {}; it must be ({count},)", shown(shape)))),
    }
}

/// The pixels of a picture [height, width, 3], row by row from the top.
pub fn pixels(what: &str, numbers: &Numbers, width: u32, height: u32) -> PyResult<Vec<DVec3>> {
    if *numbers.shape != [height as usize, width as usize, 3] {
        let shape = shown(&numbers.shape);
        return Err(invalid(format!("{what} has the shape {shape}; it must be ({height}, {width}, 3)")));
    }
    Ok(numbers.values.as_chunks().0.iter().copied().map(DVec3::from_array).collect())
}

/// A shape as Python shows it.
pub fn shown(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        shape => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// One number for all three channels, or three.
#[derive(FromPyObject)]
pub enum Triple {
    /// The same for all.
    One(f64),
    /// RGB.
    Three([f64; 3]),
}

impl From<Triple> for [f64; 3] {
    fn from(triple: Triple) -> Self {
        match triple {
            Triple::One(value) => [value; 3],
            Triple::Three(values) => values,
        }
    }
}
