//! Errors of the library as exceptions, with the same words.

use antirad::EngineError;
use antirad::ambiguity::{AmbiguityError, PolytopeError};
use antirad::fit::{FitError, RenderError, TargetError};
use antirad::gpu::GpuError;
use antirad::image::ImageError;
use antirad::output::OutputError;
use antirad::plan::PlanError;
use antirad::scene::SceneError;
use antirad::warnings::RefineError;
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use std::fmt::Display;

/// The exceptions by their names in Python.
pub mod exceptions {
    use pyo3::create_exception;
    use pyo3::exceptions::PyException;

    create_exception!(
        antirad,
        Error,
        PyException,
        "An operation of antirad failed. The message says why, and the way out."
    );
    create_exception!(antirad, SceneError, Error, "A scene, a material or a camera is invalid.");
    create_exception!(
        antirad,
        PlanError,
        Error,
        "There is no plan for a scene, for instance because it exceeds the memory budget."
    );
    create_exception!(antirad, DeviceError, Error, "No Vulkan device, or one that failed.");
    create_exception!(antirad, SolveError, Error, "A solve diverged, or did not converge.");
    create_exception!(antirad, PictureError, Error, "A picture could not be made, read or written.");
    create_exception!(antirad, FitError, Error, "A fit has no result.");
}

/// An error of the library.
pub trait Raise {
    /// The exception for it.
    fn raise(self) -> PyErr;
}

/// Results of the library.
pub trait OrRaise<T> {
    /// The value, or the exception for the error.
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Raise> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(Raise::raise)
    }
}

impl Raise for SceneError {
    fn raise(self) -> PyErr {
        exceptions::SceneError::new_err(self.to_string())
    }
}

impl Raise for PlanError {
    fn raise(self) -> PyErr {
        match self {
            Self::Scene(error) => error.raise(),
            error => exceptions::PlanError::new_err(error.to_string()),
        }
    }
}

impl Raise for RefineError {
    fn raise(self) -> PyErr {
        match self {
            Self::Plan(error) => error.raise(),
            error => exceptions::PlanError::new_err(error.to_string()),
        }
    }
}

impl Raise for GpuError {
    fn raise(self) -> PyErr {
        exceptions::DeviceError::new_err(self.to_string())
    }
}

impl Raise for EngineError {
    fn raise(self) -> PyErr {
        match self {
            Self::Scene(error) => error.raise(),
            Self::Plan(error) => error.raise(),
            Self::Gpu(error) => error.raise(),
            error if error.is_without_answer() => exceptions::SolveError::new_err(error.to_string()),
            error if error.is_device_lost() => exceptions::DeviceError::new_err(error.to_string()),
            error => exceptions::Error::new_err(error.to_string()),
        }
    }
}

impl Raise for ImageError {
    fn raise(self) -> PyErr {
        match self {
            Self::Scene(error) => error.raise(),
            Self::Gpu(error) => error.raise(),
            error => exceptions::PictureError::new_err(error.to_string()),
        }
    }
}

impl Raise for OutputError {
    fn raise(self) -> PyErr {
        PyOSError::new_err(self.to_string())
    }
}

impl Raise for TargetError {
    fn raise(self) -> PyErr {
        exceptions::PictureError::new_err(self.to_string())
    }
}

impl Raise for RenderError {
    fn raise(self) -> PyErr {
        let lost = self.is_device_lost();
        match self {
            Self::NoAnswer(message) => exceptions::SolveError::new_err(message),
            Self::Failed(_) if lost => exceptions::DeviceError::new_err(self.to_string()),
            Self::Failed(cause) => match cause.downcast::<EngineError>() {
                Ok(error) => error.raise(),
                Err(cause) => match cause.downcast::<ImageError>() {
                    Ok(error) => error.raise(),
                    Err(cause) => exceptions::Error::new_err(cause.to_string()),
                },
            },
            error => exceptions::Error::new_err(error.to_string()),
        }
    }
}

impl Raise for FitError {
    fn raise(self) -> PyErr {
        match self {
            Self::Input(error) => error.raise(),
            Self::Render(error) => error.raise(),
            Self::Image(error) => error.raise(),
            error => exceptions::FitError::new_err(error.to_string()),
        }
    }
}

impl Raise for AmbiguityError {
    fn raise(self) -> PyErr {
        match self {
            Self::Engine(error) => error.raise(),
            Self::Plan(error) => error.raise(),
            Self::Image(error) => error.raise(),
            error => exceptions::Error::new_err(error.to_string()),
        }
    }
}

impl Raise for PolytopeError {
    fn raise(self) -> PyErr {
        exceptions::Error::new_err(self.to_string())
    }
}

/// A ValueError.
pub fn invalid(message: impl Display) -> PyErr {
    PyValueError::new_err(message.to_string())
}

/// One of the words of an enumeration of the library, as in scene and job files.
pub fn word<T: DeserializeOwned>(what: &str, word: &str) -> PyResult<T> {
    serde_json::from_value(word.into()).map_err(|error| invalid(format!("{what}: {error}")))
}
