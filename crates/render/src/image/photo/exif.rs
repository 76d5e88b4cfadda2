//! What EXIF data say of an exposure.

use exif::{Exif, In, Reader, Tag, Value};

/// Exposure time in seconds times ISO over the square of the f-number.
pub(super) fn exposure(data: Vec<u8>) -> Option<f64> {
    let exif = Reader::new().read_raw(data).ok()?;
    let seconds = number(&exif, Tag::ExposureTime)?;
    let iso = number(&exif, Tag::PhotographicSensitivity)?;
    let f_number = number(&exif, Tag::FNumber)?;
    let exposure = seconds * iso / (f_number * f_number);
    (exposure > 0.0 && exposure.is_finite()).then_some(exposure)
}

fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64),
        value => value.get_uint(0).map(f64::from),
    }
}
