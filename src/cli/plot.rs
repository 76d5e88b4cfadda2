//! Plots of measurements with logarithmic axes, as SVG and PNG.

use crate::output::{OutputError, atomic_write};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use std::io::{self, Write};
use std::path::Path;

const WIDTH: u32 = 900;
const HEIGHT: u32 = 640;

/// One curve: points in the plot's units, and its text in the legend.
pub struct Curve {
    /// Text of the curve in the legend.
    pub label: String,
    /// x and y, in the units of the axes.
    pub points: Vec<(f64, f64)>,
    /// How the curve is drawn: as a line, as marks, or both.
    pub drawn: Drawn,
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drawn {
    /// A line with a mark at each point.
    Curve,
    /// Marks alone.
    Points,
    /// A thin line without marks, for reference.
    Line,
}

/// A plot with a logarithmic y axis, which shows values above 0. Axis texts carry the units.
pub struct LogPlot {
    /// Above the plot.
    pub title: String,
    /// Text of the x axis.
    pub x: String,
    /// Text of the y axis.
    pub y: String,
    /// The curves, in the order of the legend.
    pub curves: Vec<Curve>,
    /// A linear x axis, from the first point on; else a logarithmic one.
    pub linear_x: bool,
}

impl LogPlot {
    /// Writes `path` with the endings svg and png.
    pub fn write(&self, path: &Path) -> Result<(), OutputError> {
        register_font();
        let mut svg = String::new();
        let drawn = self.draw(SVGBackend::with_string(&mut svg, (WIDTH, HEIGHT)).into_drawing_area());
        atomic_write(&path.with_extension("svg"), |file| {
            drawn.map_err(io::Error::other)?;
            file.write_all(svg.as_bytes())
        })?;
        let mut pixels = vec![0; (WIDTH * HEIGHT * 3) as usize];
        let drawn = self.draw(BitMapBackend::with_buffer(&mut pixels, (WIDTH, HEIGHT)).into_drawing_area());
        atomic_write(&path.with_extension("png"), |file| {
            drawn.map_err(io::Error::other)?;
            let encoder = image::codecs::png::PngEncoder::new(file);
            let kind = image::ExtendedColorType::Rgb8;
            image::ImageEncoder::write_image(encoder, &pixels, WIDTH, HEIGHT, kind).map_err(io::Error::other)
        })
    }

    fn draw<B: DrawingBackend>(&self, area: DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        self.draw_on(&area).map_err(|error| error.to_string())
    }

    fn draw_on<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>>
    where
        B::ErrorType: 'static,
    {
        let points = || self.curves.iter().flat_map(|c| &c.points).filter(|p| p.1 > 0.0);
        let ends = |of: fn(&(f64, f64)) -> f64| {
            let (low, high) = points().map(of).fold((f64::MAX, f64::MIN), |(l, h), v| (v.min(l), v.max(h)));
            if low <= high { (low, high) } else { (1.0, 1.0) }
        };
        let range = |of| {
            let (low, high) = ends(of);
            low * 0.8..high * 1.25
        };
        if self.linear_x {
            let (low, high) = ends(|p| p.0);
            self.draw_with(area, low..high.max(low + 1.0), range(|p| p.1))
        } else {
            self.draw_with(area, range(|p| p.0).log_scale(), range(|p| p.1))
        }
    }

    fn draw_with<B: DrawingBackend, X>(
        &self,
        area: &DrawingArea<B, Shift>,
        x: X,
        y: std::ops::Range<f64>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>>
    where
        B::ErrorType: 'static,
        X: AsRangedCoord<Value = f64>,
        X::CoordDescType: ValueFormatter<f64>,
    {
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 24))
            .margin(16)
            .x_label_area_size(48)
            .y_label_area_size(80)
            .build_cartesian_2d(x, y.log_scale())?;
        // Ticks of logarithmic axes are powers of ten but for rounding.
        let number = |v: &f64| match v.abs() {
            0.0 => "0".to_owned(),
            size if (1e-3..1e4).contains(&size) => format!("{}", (v * 1e6).round() / 1e6),
            _ => format!("{v:.0e}"),
        };
        chart
            .configure_mesh()
            .x_desc(&self.x)
            .y_desc(&self.y)
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 17))
            .x_label_formatter(&number)
            .y_label_formatter(&number)
            .draw()?;
        let shown = |curve: &Curve| curve.points.clone().into_iter().filter(|p| p.1 > 0.0);
        // Many marks would hide each other.
        let mark = if self.curves.iter().map(|c| c.points.len()).sum::<usize>() > 60 { 2 } else { 4 };
        for (k, curve) in self.curves.iter().enumerate() {
            let colour = Palette99::pick(k).to_rgba();
            let width = if curve.drawn == Drawn::Line { 1 } else { 2 };
            let line = if curve.drawn == Drawn::Points { Vec::new() } else { shown(curve).collect() };
            chart
                .draw_series(LineSeries::new(line, colour.stroke_width(width)))?
                .label(&curve.label)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(width)));
            if curve.drawn != Drawn::Line {
                chart.draw_series(shown(curve).map(|p| Circle::new(p, mark, colour.filled())))?;
            }
        }
        chart
            .configure_series_labels()
            .position(if self.linear_x {
                SeriesLabelPosition::UpperRight
            } else {
                SeriesLabelPosition::UpperLeft
            })
            .label_font(("sans-serif", 16))
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .draw()?;
        area.present()
    }
}

/// Slope of the least-squares line through points in log-log space; `None` below two points.
pub fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let (xy, xx) =
        logs.iter().fold((0.0, 0.0), |(xy, xx), (x, y)| (xy + (x - mx) * (y - my), xx + (x - mx) * (x - mx)));
    (xx > 0.0).then(|| xy / xx)
}

/// Text needs a font, and a server may have none, so one is built in.
pub(super) fn register_font() {
    // It fails only for a damaged font; then drawing fails too, with an error.
    let _ =
        plotters::style::register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_of_a_power_law() {
        let points: Vec<(f64, f64)> =
            [1.0, 3.0, 10.0, 40.0].iter().map(|&x: &f64| (x, 5.0 * x.powf(1.7))).collect();
        assert!(slope(&points).is_some_and(|s| (s - 1.7).abs() <= 1e-12));
        assert_eq!(slope(&points[..1]), None);
    }

    #[test]
    fn plots_are_pictures() {
        let folder = tempfile::tempdir().expect("a folder");
        let points = vec![(1e4, 2e6), (1e5, 2.1e7)];
        let plot = LogPlot {
            title: "memory".to_owned(),
            x: "triangles".to_owned(),
            y: "bytes".to_owned(),
            curves: vec![Curve { label: "ours".to_owned(), points, drawn: Drawn::Curve }],
            linear_x: false,
        };
        plot.write(&folder.path().join("plot")).expect("a plot");
        assert!(
            std::fs::read_to_string(folder.path().join("plot.svg")).is_ok_and(|t| t.contains("triangles"))
        );
        let picture = image::open(folder.path().join("plot.png")).expect("a picture").to_rgb8();
        assert!(picture.pixels().any(|p| p.0 != [255; 3]) && picture.dimensions() == (WIDTH, HEIGHT));
    }
}
