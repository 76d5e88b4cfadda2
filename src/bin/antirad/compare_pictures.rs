//! `antirad compare` of two pictures.

use crate::Failure;
use antirad::image::Picture;
use std::path::Path;

/// Radiance whose square keeps relMSE finite where the truth is dark, squared: (W/(m² sr))².
const DARK: f64 = 0.01;

/// The values of a picture: all channels of all pixels.
fn values(picture: &Picture) -> impl Iterator<Item = f64> {
    picture.pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b].map(f64::from))
}

fn read(path: &Path) -> Result<Picture, Failure> {
    let picture = Picture::read_exr(path)?;
    let wrong = values(&picture).position(|value| !value.is_finite());
    let Some(at) = wrong else { return Ok(picture) };
    let (x, y) = (at / 3 % picture.width as usize, at / 3 / picture.width as usize);
    let message = format!("{}: pixel {x}, {y} is not finite: repair the picture", path.display());
    Err(Failure::Error(message.into()))
}

/// A difference from the truth, or the standard error of a picture.
struct Deviation {
    /// ‖d‖ / ‖t‖
    relative: f64,
    /// mean(d² / (t² + 0.01))
    rel_mse: f64,
}

impl Deviation {
    fn new(of: impl Iterator<Item = f64>, truth: &Picture) -> Self {
        let (mut squares, mut signal, mut relative, mut count) = (0.0, 0.0, 0.0, 0.0);
        for (d, t) in of.zip(values(truth)) {
            squares += d * d;
            signal += t * t;
            relative += d * d / (t * t + DARK);
            count += 1.0;
        }
        Self { relative: (squares / signal).sqrt(), rel_mse: relative / count }
    }

    fn print(&self, what: &str) {
        antirad::say!("{what:<22} {:.3} % relative L2, relMSE {:.2e}", 100.0 * self.relative, self.rel_mse);
    }
}

/// Prints by how much a picture is off, and how much of that is noise, where `antirad trace` has left standard errors.
pub fn run(truth_file: &Path, found_file: &Path) -> Result<(), Failure> {
    let (truth, found) = (read(truth_file)?, read(found_file)?);
    let size = |picture: &Picture| format!("{} x {}", picture.width, picture.height);
    let refuse = |message: String| Err(Failure::Error(message.into()));
    if size(&truth) != size(&found) {
        let (first, second) = (truth_file.display(), found_file.display());
        return refuse(format!(
            "{first} and {second} cannot be compared: they have {} and {} pixels",
            size(&truth),
            size(&found)
        ));
    }
    let sum = values(&truth).sum::<f64>();
    if sum == 0.0 {
        return refuse(format!("{} is black: nothing can be compared with it", truth_file.display()));
    }
    let difference = || values(&found).zip(values(&truth)).map(|(found, truth)| found - truth);
    Deviation::new(difference(), &truth).print("difference");
    for (file, what) in [(truth_file, "noise of the first"), (found_file, "noise of the second")] {
        let errors = file.with_extension("error.exr");
        if errors.is_file() {
            let errors = read(&errors)?;
            if size(&errors) == size(&truth) {
                Deviation::new(values(&errors), &truth).print(what);
            }
        }
    }
    antirad::say!("{:<22} {:+.3} %", "mean radiance", 100.0 * difference().sum::<f64>() / sum);
    antirad::say!("relMSE = mean(d²/(t² + {DARK})), d the difference and t the first picture, W/(m² sr)");
    Ok(())
}
