//! Plots of measurements with logarithmic axes, as SVG.

use crate::output::{OutputError, atomic_write};
use std::io::Write;
use std::path::Path;

/// Size of a plot, pixels, and what is left free around the axes for texts.
const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 640.0;
const LEFT: f64 = 96.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 52.0;
const BOTTOM: f64 = 64.0;
/// Colours that most people can tell apart (Okabe and Ito, "Color Universal Design", 2008).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
/// Height of a line of the legend, and a generous width of a letter in it, pixels.
const LINE: f64 = 22.0;
const LETTER: f64 = 8.5;

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

/// An axis: its ends, where they lie in the picture, and whether it is logarithmic.
struct Axis {
    ends: [f64; 2],
    pixels: [f64; 2],
    log: bool,
}

impl Axis {
    fn place(&self, value: f64) -> f64 {
        let [low, high] = self.ends;
        let share =
            if self.log { (value / low).ln() / (high / low).ln() } else { (value - low) / (high - low) };
        self.pixels[0] + share * (self.pixels[1] - self.pixels[0])
    }

    /// Values with a line and a number: round ones, at least four where the axis has as many.
    fn ticks(&self) -> Vec<f64> {
        let [low, high] = self.ends;
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let within = |value: &f64| (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(value);
        let of = |steps: &[f64]| -> Vec<f64> {
            let all =
                decades.clone().flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
            all.filter(within).collect()
        };
        if self.log {
            let few = of(&[1.0]);
            return if few.len() < 4 { of(&[1.0, 2.0, 5.0]) } else { few };
        }
        let rough = (high - low) / 8.0;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade).into_iter().find(|step| *step >= rough);
        let step = step.unwrap_or(rough);
        let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

impl LogPlot {
    /// Writes `path` with the ending svg.
    pub fn write(&self, path: &Path) -> Result<(), OutputError> {
        atomic_write(&path.with_extension("svg"), |file| file.write_all(self.svg().as_bytes()))
    }

    fn axes(&self) -> [Axis; 2] {
        let ends = |of: fn(&(f64, f64)) -> f64| {
            let points = self.curves.iter().flat_map(shown).map(of);
            let (low, high) = points.fold((f64::MAX, f64::MIN), |(l, h), v| (v.min(l), v.max(h)));
            if low <= high { [low, high] } else { [1.0, 1.0] }
        };
        let wider = |[low, high]: [f64; 2]| [low * 0.8, high * 1.25];
        let x = ends(|p| p.0);
        let x = if self.linear_x { [x[0], x[1].max(x[0] + 1.0)] } else { wider(x) };
        [
            Axis { ends: x, pixels: [LEFT, WIDTH - RIGHT], log: !self.linear_x },
            Axis { ends: wider(ends(|p| p.1)), pixels: [HEIGHT - BOTTOM, TOP], log: true },
        ]
    }

    fn svg(&self) -> String {
        let [x, y] = self.axes();
        // Texts lie over all else.
        let mut texts = Vec::new();
        let mut parts = vec![format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" font-family="sans-serif" font-size="15">
<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>"#
        )];
        let mut text = |x: f64, y: f64, style: &str, text: &str| {
            let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
            texts.push(format!(r#"<text x="{x:.1}" y="{y:.1}" {style}>{text}</text>"#));
        };
        let middle = r#"text-anchor="middle" font-size="17""#;
        text(WIDTH / 2.0, 32.0, r#"text-anchor="middle" font-size="24""#, &self.title);
        text((LEFT + WIDTH - RIGHT) / 2.0, HEIGHT - 16.0, middle, &self.x);
        let across = (TOP + HEIGHT - BOTTOM) / 2.0;
        text(24.0, across, &format!(r#"{middle} transform="rotate(-90 24 {across})""#), &self.y);
        for tick in x.ticks() {
            text(x.place(tick), HEIGHT - BOTTOM + 20.0, r#"text-anchor="middle""#, &number(tick));
        }
        for tick in y.ticks() {
            text(LEFT - 8.0, y.place(tick) + 5.0, r#"text-anchor="end""#, &number(tick));
        }
        let width =
            self.curves.iter().map(|c| c.label.chars().count()).max().unwrap_or(0) as f64 * LETTER + 48.0;
        let legend = if self.linear_x { WIDTH - RIGHT - width - 8.0 } else { LEFT + 8.0 };
        for (k, curve) in self.curves.iter().enumerate() {
            text(legend + 38.0, TOP + 13.0 + LINE * (k as f64 + 0.7), "", &curve.label);
        }

        let mut line = |[a, b]: [f64; 2], [c, d]: [f64; 2], stroke: &str| {
            parts.push(format!(r#"<path d="M{a:.1} {b:.1}L{c:.1} {d:.1}" stroke="{stroke}"/>"#));
        };
        let (bottom, right) = (HEIGHT - BOTTOM, WIDTH - RIGHT);
        for at in x.ticks().into_iter().map(|tick| x.place(tick)) {
            line([at, TOP], [at, bottom], "#ddd");
        }
        for at in y.ticks().into_iter().map(|tick| y.place(tick)) {
            line([LEFT, at], [right, at], "#ddd");
        }
        line([LEFT, TOP], [LEFT, bottom], "black");
        line([LEFT, bottom], [right, bottom], "black");
        // Many marks would hide each other.
        let mark = if self.curves.iter().map(|c| c.points.len()).sum::<usize>() > 60 { 2 } else { 4 };
        let mut keys = Vec::new();
        for (k, curve) in self.curves.iter().enumerate() {
            let (colour, row) = (COLOURS[k % COLOURS.len()], TOP + 8.0 + LINE * (k as f64 + 0.7));
            let width = if curve.drawn == Drawn::Line { 1 } else { 2 };
            let places: Vec<[f64; 2]> = shown(curve).map(|p| [x.place(p.0), y.place(p.1)]).collect();
            if curve.drawn != Drawn::Points {
                let points: Vec<String> = places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
                let points = points.join(" ");
                parts.push(format!(
                    r#"<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"/>"#
                ));
            }
            if curve.drawn != Drawn::Line {
                let circle = |[x, y]: &[f64; 2]| {
                    format!(r#"<circle cx="{x:.1}" cy="{y:.1}" r="{mark}" fill="{colour}"/>"#)
                };
                parts.extend(places.iter().map(circle));
            }
            let from = legend + 8.0;
            keys.push(format!(
                r#"<path d="M{from:.1} {row:.1}h22" stroke="{colour}" stroke-width="{width}"/>"#
            ));
        }
        let height = LINE * self.curves.len() as f64 + 8.0;
        let top = TOP + 8.0;
        parts.push(format!(
            r##"<rect x="{legend:.1}" y="{top}" width="{width:.1}" height="{height:.1}" fill="white" fill-opacity="0.85" stroke="#aaa"/>"##
        ));
        parts.extend(keys);
        parts.extend(texts);
        parts.push("</svg>\n".to_owned());
        parts.join("\n")
    }
}

/// Points above 0, which a logarithmic axis can show.
fn shown(curve: &Curve) -> impl Iterator<Item = &(f64, f64)> {
    curve.points.iter().filter(|point| point.1 > 0.0)
}

fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        // Ticks of logarithmic axes are round but for rounding.
        size if (1e-3..1e4).contains(&size) => format!("{}", (value * 1e6).round() / 1e6),
        _ => format!("{value:.0e}"),
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

    fn plot(points: Vec<(f64, f64)>, linear_x: bool) -> LogPlot {
        let curves = vec![Curve { label: "a < b".to_owned(), points, drawn: Drawn::Curve }];
        let [title, x, y] = ["memory", "triangles", "bytes"].map(str::to_owned);
        LogPlot { title, x, y, curves, linear_x }
    }

    #[test]
    fn plots_are_drawings() {
        let folder = tempfile::tempdir().expect("a folder");
        plot(vec![(1e4, 2e6), (1e5, 2.1e7)], false).write(&folder.path().join("plot")).expect("a plot");
        let text = std::fs::read_to_string(folder.path().join("plot.svg")).expect("a plot");
        for part in ["triangles", "a &lt; b", "1e5", "<circle", "<polyline"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        // Without a value that can be shown it is empty.
        assert!(!plot(vec![(0.0, 0.0)], true).svg().contains("NaN"));
    }

    #[test]
    fn ticks_are_round() {
        let axis = |ends, log| Axis { ends, pixels: [0.0, 1.0], log };
        assert_eq!(axis([1.0, 90.0], true).ticks().len(), 6);
        assert_eq!(axis([0.5, 2e4], true).ticks().len(), 5);
        assert_eq!(axis([0.0, 40.0], false).ticks(), [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0]);
        assert_eq!(axis([10.0, 1000.0], true).place(100.0), 0.5);
    }
}
