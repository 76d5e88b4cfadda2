//! Predicts where the method will be wrong, and names the triangles that cause it: without a solve
//! ([`Warnings::of`]), or from a solution ([`Warnings::after`]). Pure host code between plan and engine.

mod backs;
mod distance;
mod edges;
mod effect;
mod gain;
mod gaps;
mod layers;
mod refine;
mod shadows;

pub use effect::{Effect, MATTERS, told_from};
pub(crate) use refine::CUT;
pub use refine::{RefineError, RefineOptions, Refined, refine};

use crate::path_tracer::PathTracer;
use antirad_core::plan::Plan;
use antirad_scene::Scene;
use edges::Edges;
pub use gain::Surfaces;
use gain::{Gain, Gains};
use layers::Layers;
use serde::Serialize;
use std::fmt;

/// Largest a/(d² s_b) without a warning: above it, the error of a shadow grows with the size of triangles.
const GAIN_LIMIT: f64 = 0.5;
/// Number of examples that a warning prints.
const SHOWN: usize = 5;
/// Largest share of a triangle in the error of reflected light of lamps without a warning.
const SHADOW_LIMIT: f64 = 0.01;
/// Error of irradiance over the square of that of what triangles reflect evenly: others see their neighbours beside them. The largest over
/// rooms, boxes and floors of this repository, with and without refinement.
const UNEVEN: f64 = 0.4;
/// Error of irradiance on both sides of narrow gaps, relative to it. Likewise.
const IN_GAPS: f64 = 0.3;

/// What a warning is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A blocker subtends too much of a direction bin, seen from a receiver behind it.
    CoarseBlockers,
    /// Blockers behind one another whose errors multiply.
    StackedLayers,
    /// Triangles face each other at less than half their size.
    NarrowGaps,
    /// Blockers with an open edge.
    OpenBlockers,
    /// A shadow, or the bright spot under a lamp, lies within triangles.
    CoarseShadows,
    /// Light falls on the backs of triangles.
    LitBacks,
    /// Blockers with some triangles of opposite orientation.
    InconsistentBlockers,
    /// Triangles with the same corners and front as another.
    DuplicateTriangles,
    /// The spectral radius of the transport is 1 or more, so that it creates light.
    Unphysical,
    /// Irradiance below zero.
    NegativeIrradiance,
}

impl Kind {
    /// A name of one or two words, for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::CoarseBlockers => "coarse blockers",
            Self::StackedLayers => "stacked layers",
            Self::NarrowGaps => "narrow gaps",
            Self::OpenBlockers => "open blockers",
            Self::CoarseShadows => "coarse shadows",
            Self::LitBacks => "lit backs",
            Self::InconsistentBlockers => "inconsistent blockers",
            Self::DuplicateTriangles => "duplicate triangles",
            Self::Unphysical => "unphysical",
            Self::NegativeIrradiance => "negative irradiance",
        }
    }
}

/// One of the worst triangles of a warning.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Example {
    /// Index in the scene.
    pub triangle: u32,
    /// Origin of the triangle, such as `room.obj:17 (triangle 5 of mesh "room")`.
    pub place: String,
    /// Value of [`Warning::measure`].
    pub value: f64,
    /// The other triangle concerned, such as the receiver behind a blocker, if there is one.
    pub other: Option<u32>,
    /// Origin of the other triangle.
    pub other_place: Option<String>,
}

/// A cause of errors, with the triangles concerned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Warning {
    /// The cause.
    pub kind: Kind,
    /// What it does to the answer.
    pub effect: Effect,
    /// What is wrong, in a sentence.
    pub message: String,
    /// What to do about it.
    pub remedy: String,
    /// The quantity that ranks the triangles, with its unit.
    pub measure: &'static str,
    /// Number of triangles concerned.
    pub count: usize,
    /// Share of these triangles in the scene's area, 0 to 1.
    pub area_share: f64,
    /// The worst triangles.
    pub worst: Vec<Example>,
    /// All triangles concerned, the worst first.
    #[serde(skip)]
    pub triangles: Vec<u32>,
    /// The triangles at which light is wrong, where they are others.
    #[serde(skip)]
    wrong: Option<Vec<u32>>,
}

/// All warnings of a scene under a plan.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Warnings {
    /// The warnings, at most one of each kind.
    pub list: Vec<Warning>,
}

/// Area of all that does not only emit, as a sky does, in the plan's unit.
fn area(scene: &Scene, plan: &Plan) -> f64 {
    let counts = |i: &usize| !scene.material(*i).only_emits();
    (0..plan.facets().len()).filter(counts).map(|i| plan.facets()[i].area).sum::<f64>().max(f64::MIN_POSITIVE)
}

/// A triangle, its value and the other triangle concerned.
type Found = (u32, f64, Option<u32>);

impl Warnings {
    /// Warnings before a solve. Takes about as long as planning, since only pairs of nearby triangles are examined.
    pub fn of(scene: &Scene, plan: &Plan) -> Self {
        let mut warnings = Self::default();
        if !plan.transport().is_explicit() {
            let gains = Gains::above(GAIN_LIMIT, plan.into());
            warnings.stacked_layers(scene, plan, &gains);
            warnings.coarse_blockers(scene, plan, &gains);
            warnings.narrow_gaps(scene, plan);
        }
        warnings.bad_edges(scene, plan);
        warnings.lit_backs(scene, plan);
        warnings
    }

    /// The warnings of [`Warnings::of`], and [`Kind::CoarseShadows`]. Takes about as long as the direct light
    /// of lamps.
    #[doc(hidden)]
    pub fn with_shadows(scene: &Scene, plan: &Plan) -> Self {
        let mut warnings = Self::of(scene, plan);
        let found = shadows::uneven(scene, plan, SHADOW_LIMIT);
        let error = found.iter().map(|(_, share)| share * share).sum::<f64>().sqrt();
        let found = found.into_iter().map(|(t, share)| (t, share, None)).collect();
        warnings.push(scene, plan, found, |count| Warning {
            kind: Kind::CoarseShadows,
            effect: Effect::predicted(UNEVEN * error * error),
            message: format!(
                "the light of lamps varies within {count} triangles: what they reflect, evenly, is off by {:.1} %",
                100.0 * error
            ),
            remedy: "antirad refine; their own irradiance and picture are right"
                .to_owned(),
            measure: "share in the relative error of reflected light of lamps",
            ..Warning::blank()
        });
        warnings
    }

    /// Warnings after a solve, from the irradiance of each triangle, W/m², and the estimate of the spectral radius, if the solver
    /// has one.
    pub fn after(scene: &Scene, plan: &Plan, irradiance: &[[f64; 3]], spectral_radius: Option<f64>) -> Self {
        let mut warnings = Self::default();
        if let Some(radius) = spectral_radius.filter(|&radius| radius >= 1.0) {
            warnings.list.push(unphysical(scene, plan, radius));
        }
        let lowest = |i: usize| irradiance[i].iter().copied().fold(f64::INFINITY, f64::min);
        let mut found: Vec<Found> = (0..scene.triangles.len())
            .map(|i| (i as u32, lowest(i), None))
            .filter(|&(_, h, _)| h < 0.0)
            .collect();
        found.sort_by(|a, b| a.1.total_cmp(&b.1));
        let power = |of: &dyn Fn(f64) -> f64| -> f64 {
            let sum = |i: usize| irradiance[i].iter().map(|&h| of(h)).sum::<f64>();
            (0..scene.triangles.len()).map(|i| plan.facets()[i].area * sum(i)).sum()
        };
        let share = power(&|h| (-h).max(0.0)) / power(&f64::abs).max(f64::MIN_POSITIVE);
        warnings.push(scene, plan, found, |count| Warning {
            kind: Kind::NegativeIrradiance,
            effect: Effect { share, measured: Some(0.0) },
            message: format!(
                "{count} triangles have negative irradiance, {:.2} % of all light by magnitude: more antiradiance than light \
                 is incident there",
                100.0 * share
            ),
            remedy: "antirad refine, or a finer mesh near blockers; small amounts are normal".to_owned(),
            measure: "irradiance, W/m²",
            ..Warning::blank()
        });
        warnings
    }

    /// Replaces the predicted effects that matter by what path tracing finds of the irradiance of a solution, W/m² per triangle. Takes about
    /// ten thousand paths for each.
    #[doc(hidden)]
    pub fn measure(&mut self, scene: &Scene, plan: &Plan, irradiance: &[[f64; 3]]) {
        use Kind::{CoarseBlockers, NarrowGaps, StackedLayers};
        let kinds = [StackedLayers, CoarseBlockers, NarrowGaps];
        let mut doubtful =
            self.list.iter_mut().filter(|w| kinds.contains(&w.kind) && w.effect.exceeds(MATTERS)).peekable();
        if doubtful.peek().is_none() {
            return;
        }
        let tracer = PathTracer::new(scene);
        for warning in doubtful {
            let wrong = warning.wrong.as_ref().unwrap_or(&warning.triangles);
            warning.effect = effect::measured(plan, &tracer, irradiance, wrong);
        }
    }

    /// Those that may change the answer by more than a share of its light, [`MATTERS`] for instance.
    #[doc(hidden)]
    pub fn above(&self, share: f64) -> impl Iterator<Item = &Warning> {
        self.list.iter().filter(move |warning| warning.effect.exceeds(share))
    }

    /// The warning of a kind.
    pub fn get(&self, kind: Kind) -> Option<&Warning> {
        self.list.iter().find(|w| w.kind == kind)
    }

    /// Number of triangles under any warning, each counted once per warning.
    pub fn count(&self) -> usize {
        self.list.iter().map(|w| w.count).sum()
    }

    fn stacked_layers(&mut self, scene: &Scene, plan: &Plan, gains: &Gains) {
        let layers = Layers::of(gains);
        let stacked = layers.stacked();
        let Some(&worst) = stacked.first() else { return };
        let chain = layers.chain(worst);
        let mut names: Vec<&str> = chain.triangles.iter().map(|&t| mesh_name(scene, t)).collect();
        names.dedup();
        let links = chain.triangles.len() - 1;
        let product = if chain.endless {
            "without bound: some blockers form a cycle, each behind the other".to_owned()
        } else {
            format!("up to {:.1e}", chain.gain)
        };
        let found = stacked.iter().map(|&t| (t, layers.product(t), None)).collect();
        let errors = effect::behind_layers(plan, &layers, &stacked);
        self.push(scene, plan, found, |count| Warning {
            kind: Kind::StackedLayers,
            effect: Effect::predicted(effect::of_area(plan, errors.into_iter())),
            message: format!(
                "{count} triangles lie behind two or more layers whose errors multiply, {product}; the worst stack has {links} \
                 layers: {}",
                quoted(&names)
            ),
            remedy: "antirad refine, a mesh finer than the distance of the layers, bins of equal size (--bins \
                      concentric:10), or one layer in place of several"
                .to_owned(),
            measure: "product of a/(d² s_b) over the layers",
            ..Warning::blank()
        });
    }

    fn coarse_blockers(&mut self, scene: &Scene, plan: &Plan, gains: &Gains) {
        let mut worst: Vec<Gain> = gains.of_blocker.iter().flatten().copied().collect();
        worst.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let receivers = gains.strongest.iter().filter(|list| !list.is_empty()).count();
        let found = worst.iter().map(|g| (g.blocker, g.gain, Some(g.receiver))).collect();
        let errors = effect::behind_blockers(plan, gains);
        self.push(scene, plan, found, |count| Warning {
            kind: Kind::CoarseBlockers,
            effect: Effect::predicted(effect::of_area(plan, errors.iter().copied())),
            wrong: Some(errors.into_iter().map(|(receiver, _)| receiver).collect()),
            message: format!(
                "{count} blockers are too large for {} bins, seen from {receivers} triangles close behind them: shadows \
                 there are wrong by about a tenth of a/(d² s_b), which should be below {GAIN_LIMIT}",
                plan.settings().bins
            ),
            remedy: "antirad refine, a finer mesh, or bins of equal size (--bins concentric:10)".to_owned(),
            measure: "a/(d² s_b): the blocker's solid angle, in pieces, over that of a bin",
            ..Warning::blank()
        });
    }

    fn narrow_gaps(&mut self, scene: &Scene, plan: &Plan) {
        let mut gaps = gaps::gaps(plan);
        gaps.sort_by(|a, b| a.share.total_cmp(&b.share));
        let found = gaps.iter().map(|g| (g.wide, g.share, Some(g.other))).collect();
        let mut sides: Vec<u32> = gaps.iter().flat_map(|g| [g.wide, g.other]).collect();
        sides.sort_unstable();
        sides.dedup();
        self.push(scene, plan, found, |count| Warning {
            kind: Kind::NarrowGaps,
            effect: Effect::predicted(effect::of_area(plan, sides.iter().map(|&side| (side, IN_GAPS)))),
            wrong: Some(sides),
            message: format!(
                "{count} triangles face others at less than half their own size: light leaks from the gap"
            ),
            remedy: "antirad refine, close the gap, or remove the surfaces in it".to_owned(),
            measure: "width of the gap over the triangle's size √s",
            ..Warning::blank()
        });
    }

    fn bad_edges(&mut self, scene: &Scene, plan: &Plan) {
        let Edges { open, inconsistent, duplicate } = Edges::of(plan);
        // What reflects or blocks light twice, or not at all; of lamps also what they emit.
        let whole = |list: &[u32]| {
            let emitted = |i: u32| {
                plan.facets()[i as usize].area * scene.material(i as usize).emission.iter().sum::<f64>()
            };
            let all: f64 = (0..plan.facets().len() as u32).map(emitted).sum();
            let of_lamps = list.iter().map(|&i| emitted(i)).sum::<f64>() / all.max(f64::MIN_POSITIVE);
            Effect::predicted(effect::of_area(plan, list.iter().map(|&i| (i, 1.0))).max(of_lamps))
        };
        let by_area = |list: &[u32]| -> Vec<Found> {
            let scale = plan.placement().scale.powi(-2);
            let area = |t: u32| plan.facets()[t as usize].area * scale;
            let mut found: Vec<Found> = list.iter().map(|&t| (t, area(t), None)).collect();
            found.sort_by(|a, b| b.1.total_cmp(&a.1));
            found
        };
        self.push(scene, plan, by_area(&inconsistent), |count| Warning {
            kind: Kind::InconsistentBlockers,
            effect: whole(&inconsistent),
            message: format!(
                "{count} blockers share an edge with a triangle of opposite orientation: one of the two shows its black back, \
                 which blocks no light"
            ),
            remedy: "orient the triangles of each object so that all fronts are outside".to_owned(),
            measure: "area, m²",
            ..Warning::blank()
        });
        self.push(scene, plan, by_area(&open), |count| Warning {
            kind: Kind::OpenBlockers,
            // What passes through is that of lit backs.
            effect: Effect::predicted(0.0),
            message: format!(
                "{count} blockers have an open edge: light that hits a back there passes through"
            ),
            remedy: "close the object, or give sheets a second side; a lamp close to a ceiling does no harm"
                .to_owned(),
            measure: "area, m²",
            ..Warning::blank()
        });
        self.push(scene, plan, by_area(&duplicate), |count| Warning {
            kind: Kind::DuplicateTriangles,
            effect: whole(&duplicate),
            message: format!(
                "{count} triangles have the same corners and the same front as another: each emits, reflects and blocks light \
                 once more"
            ),
            remedy: "remove them from the mesh".to_owned(),
            measure: "area, m²",
            ..Warning::blank()
        });
    }

    fn lit_backs(&mut self, scene: &Scene, plan: &Plan) {
        let lit = backs::lit(scene, plan);
        let found: Vec<Found> = lit.backs.iter().map(|&(t, light)| (t, light, None)).collect();
        let lit_area: f64 = lit.backs.iter().map(|&(t, _)| plan.facets()[t as usize].area).sum();
        let share = lit_area / area(scene, plan);
        self.push(scene, plan, found, |count| Warning {
            kind: Kind::LitBacks,
            effect: Effect::predicted(lit.share(scene, plan)),
            message: format!(
                "light falls on the backs of {count} triangles, {:.1} % of the area: it is not reflected there{}",
                100.0 * share,
                match plan.transport().is_explicit() {
                    true => "",
                    false => ", and passes, but for what comes straight from exact lamps; with visibility = \"explicit\" backs are black",
                }
            ),
            remedy: "two_sided = true (--two-sided) for sheets; turn what faces the wrong way".to_owned(),
            measure: "irradiance of the back that is missed, W/m²",
            ..Warning::blank()
        });
    }

    /// Adds a warning if any triangles were found; the worst come first.
    fn push(
        &mut self,
        scene: &Scene,
        plan: &Plan,
        found: Vec<Found>,
        warning: impl FnOnce(usize) -> Warning,
    ) {
        if found.is_empty() {
            return;
        }
        let all = area(scene, plan);
        let area: f64 = found.iter().map(|f| plan.facets()[f.0 as usize].area).sum();
        let example = |&(triangle, value, other): &Found| Example {
            triangle,
            place: scene.place_of(triangle as usize),
            value,
            other,
            other_place: other.map(|t| scene.place_of(t as usize)),
        };
        self.list.push(Warning {
            count: found.len(),
            area_share: area / all,
            worst: found.iter().take(SHOWN).map(example).collect(),
            triangles: found.iter().map(|f| f.0).collect(),
            ..warning(found.len())
        });
    }
}

/// The spectral radius does not tell where the cause is; the likeliest are stacked layers and coarse blockers.
fn unphysical(scene: &Scene, plan: &Plan, radius: f64) -> Warning {
    let before = Warnings::of(scene, plan);
    let suspects = before.get(Kind::StackedLayers).or(before.get(Kind::CoarseBlockers));
    let size = if radius.is_finite() { format!("about {radius:.3}") } else { "above 1".to_owned() };
    Warning {
        kind: Kind::Unphysical,
        effect: Effect { share: 1.0, measured: Some(0.0) },
        message: format!(
            "the spectral radius of the transport is {size}: light is created, and the answer is unphysical"
        ),
        remedy: "visibility = \"explicit\" (--visibility explicit), or look for interpenetrating triangles, and for stacked layers \
                 closer than a triangle's size"
            .to_owned(),
        ..suspects.cloned().unwrap_or(Warning::blank())
    }
}

impl Warning {
    fn blank() -> Self {
        Self {
            kind: Kind::Unphysical,
            effect: Effect::default(),
            message: String::new(),
            remedy: String::new(),
            measure: "",
            count: 0,
            area_share: 0.0,
            worst: Vec::new(),
            triangles: Vec::new(),
            wrong: None,
        }
    }
}

fn mesh_name(scene: &Scene, triangle: u32) -> &str {
    scene.meshes.iter().find(|m| m.range.contains(&triangle)).map_or("", |m| m.name.as_str())
}

/// A list of quoted names, abbreviated in the middle if it is long.
fn quoted(names: &[&str]) -> String {
    const MOST: usize = 12;
    let quote = |names: &[&str]| names.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>().join(", ");
    match names.len() {
        0..=MOST => quote(names),
        n => format!("{}, …, {}", quote(&names[..MOST / 2]), quote(&names[n - MOST / 2..])),
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "{}", self.kind.name())?;
        writeln!(f, "  problem      {}", self.message)?;
        if self.count > 0 {
            writeln!(f, "  triangles    {}, {:.2} % of the area", self.count, 100.0 * self.area_share)?;
        }
        for (k, example) in self.worst.iter().enumerate() {
            let head = if k == 0 { "worst" } else { "" };
            write!(f, "  {head:<12} {:>9.3e}  {}", example.value, example.place)?;
            match &example.other_place {
                Some(other) => writeln!(f, ", towards {other}")?,
                None => writeln!(f)?,
            }
        }
        if !self.worst.is_empty() {
            writeln!(f, "  measured as  {}", self.measure)?;
        }
        writeln!(f, "  effect       {}", self.effect)?;
        write!(f, "  remedy       {}", self.remedy)
    }
}

impl fmt::Display for Warnings {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.list.is_empty() {
            return write!(f, "nothing to warn of");
        }
        for (k, warning) in self.list.iter().enumerate() {
            if k > 0 {
                writeln!(f, "\n")?;
            }
            write!(f, "{warning}")?;
        }
        Ok(())
    }
}
