//! NumPy arrays from values of the library and back. Results are moved into arrays, and arrays of the right type are read
//! in place.

use crate::errors::invalid;
use antirad::glam::DVec3;
use numpy::{
    AllowTypeChange, Element, PyArray, PyArray1, PyArray2, PyArray3, PyArrayLikeDyn, PyArrayMethods,
};
use pyo3::prelude::*;

/// An argument: anything that NumPy turns into an array of numbers.
pub type Numbers<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;

/// An array [rows, 3].
pub fn rows<T: Element>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Bound<'_, PyArray2<T>>> {
    let shape = [rows.len(), 3];
    PyArray::from_vec(py, rows.into_flattened()).reshape(shape)
}

/// An array [rows, 3].
pub fn points(py: Python<'_>, points: Vec<DVec3>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    rows(py, bytemuck::allocation::cast_vec(points))
}

/// An array [rows].
pub fn vector<T: Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    PyArray::from_vec(py, values)
}

/// A picture [height, width, 3].
pub fn picture(py: Python<'_>, pixels: Vec<DVec3>, width: u32) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let height = pixels.len() / (width as usize).max(1);
    points(py, pixels)?.reshape([height, width as usize, 3])
}

/// Rows of three from an array [count, 3]. `what` is its name in messages.
pub fn triples(what: &str, numbers: &Numbers, count: Option<usize>) -> PyResult<Vec<[f64; 3]>> {
    let array = numbers.as_array();
    match *array.shape() {
        [given, 3] if count.is_none_or(|count| count == given) => {}
        ref shape => {
            let wanted = count.map_or_else(|| String::from("n"), |count| count.to_string());
            return Err(invalid(format!("{what} has the shape {}; it must be ({wanted}, 3)", shown(shape))));
        }
    }
    let triple = |row: numpy::ndarray::ArrayView1<f64>| [row[0], row[1], row[2]];
    Ok(array.outer_iter().map(|row| match row.into_dimensionality() {
        Ok(row) => triple(row),
        Err(_) => unreachable!("the array has two axes"),
    }).collect())
}

/// Points from an array [count, 3].
pub fn vectors(what: &str, numbers: &Numbers, count: Option<usize>) -> PyResult<Vec<DVec3>> {
    Ok(bytemuck::allocation::cast_vec(triples(what, numbers, count)?))
}

/// Numbers from an array [count].
pub fn scalars(what: &str, numbers: &Numbers, count: usize) -> PyResult<Vec<f64>> {
    let array = numbers.as_array();
    match *array.shape() {
        [given] if given == count => Ok(array.iter().copied().collect()),
        ref shape => Err(invalid(format!("{what} has the shape {}; it must be ({count},)", shown(shape)))),
    }
}

/// The pixels of a picture [height, width, 3], row by row from the top.
pub fn pixels(what: &str, numbers: &Numbers, width: u32, height: u32) -> PyResult<Vec<DVec3>> {
    let array = numbers.as_array();
    if *array.shape() != [height as usize, width as usize, 3] {
        let shape = shown(array.shape());
        return Err(invalid(format!("{what} has the shape {shape}; it must be ({height}, {width}, 3)")));
    }
    let flat: Vec<f64> = array.iter().copied().collect();
    let (pixels, _) = flat.as_chunks::<3>();
    Ok(pixels.iter().copied().map(DVec3::from).collect())
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
