//! Convex cones of directions from a point, such as those towards a lamp: cut by planes through the point, and integrated
//! by Lambert's formula.

use glam::DVec3;

/// Sines of angles to a plane below which a direction counts as in it.
const IN_PLANE: f64 = 1e-12;

/// One side of a cone, from its corner a to that of the next side, b, clockwise seen from the apex: a × b points into the cone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Side {
    /// A direction, of any length.
    pub corner: DVec3,
    /// The plane in which the side lies, by a number that whoever cuts gives it.
    pub plane: u32,
}

fn height(side: &Side, normal: DVec3) -> f64 {
    let height = side.corner.dot(normal);
    if height.abs() <= IN_PLANE * side.corner.length() { 0.0 } else { height }
}

/// Whether any corner of a cone lies on the positive side of the plane with a unit normal, and whether any lies on the negative.
pub fn extent(cone: &[Side], normal: DVec3) -> [bool; 2] {
    let mut extent = [false; 2];
    for side in cone {
        let height = height(side, normal);
        extent[0] |= height > 0.0;
        extent[1] |= height < 0.0;
    }
    extent
}

/// Appends to `part` what lies on the positive side of the plane with unit normal `normal`, whose number is `plane`. The cone must
/// extend to both sides. With the opposite normal, it appends exactly the rest.
pub fn cut(cone: &[Side], normal: DVec3, plane: u32, part: &mut Vec<Side>) {
    let Some(mut from) = cone.last() else { return };
    let mut before = height(from, normal);
    for (k, side) in cone.iter().enumerate() {
        let after = height(side, normal);
        if before * after < 0.0 {
            // The same two products with the opposite normal: both parts have this corner to the last bit.
            let corner = from.corner.lerp(side.corner, before / (before - after));
            part.push(Side { corner, plane: if after > 0.0 { from.plane } else { plane } });
        }
        if after > 0.0 {
            part.push(*side);
        } else if after == 0.0 {
            let leaves = height(&cone[(k + 1) % cone.len()], normal) < 0.0;
            part.push(Side { corner: side.corner, plane: if leaves { plane } else { side.plane } });
        }
        (from, before) = (side, after);
    }
}

/// Each side with the corners at its ends.
pub fn sides(cone: &[Side]) -> impl Iterator<Item = (u32, [DVec3; 2])> + '_ {
    cone.iter().enumerate().map(|(k, side)| (side.plane, [side.corner, cone[(k + 1) % cone.len()].corner]))
}

/// ∫ ω dω over the cone with these sides, sr: its product with a normal is ∫ cosθ dω (J. Lambert, *Photometria*, 1760; J. Arvo, *Analytic
/// Methods for Simulated Light Transport*, 1995, section 2.3).
pub fn vector_irradiance(sides: impl Iterator<Item = (u32, [DVec3; 2])>) -> DVec3 {
    0.5 * sides.map(|(_, [a, b])| angle_times_normal(a, b)).sum::<DVec3>()
}

/// The angle of a side times the unit normal of its plane, which points into the cone.
fn angle_times_normal(a: DVec3, b: DVec3) -> DVec3 {
    let cross = a.cross(b);
    let sine = cross.length();
    if sine <= IN_PLANE * (a.length_squared() + b.length_squared()) {
        // A side without length, or one that passes the point itself.
        return DVec3::ZERO;
    }
    cross * (sine.atan2(a.dot(b)) / sine)
}

/// The arc of a side, from `a` to `b`: orthonormal directions at its start and a quarter of a circle on, and its angle. `None` for a side
/// without length, whose second direction would be rounding.
pub fn arc([a, b]: [DVec3; 2]) -> Option<(DVec3, DVec3, f64)> {
    let cross = a.cross(b);
    let sine = cross.length();
    if sine <= IN_PLANE * (a.length_squared() + b.length_squared()) {
        return None;
    }
    let e1 = a.normalize();
    Some((e1, (cross / sine).cross(e1), sine.atan2(a.dot(b))))
}

/// ∫ ω ⟨ω, v⟩ ds along the arc of a side, from `a` to `b`.
pub fn arc_moment(ends: [DVec3; 2], v: DVec3) -> DVec3 {
    let Some((e1, e2, angle)) = arc(ends) else { return DVec3::ZERO };
    // ∫ cos², ∫ sin², ∫ sin cos over the angle.
    let (sin, cos) = angle.sin_cos();
    let (squares, product) = ([0.5 * (angle + sin * cos), 0.5 * (angle - sin * cos)], 0.5 * sin * sin);
    let (along1, along2) = (v.dot(e1), v.dot(e2));
    e1 * (squares[0] * along1 + product * along2) + e2 * (product * along1 + squares[1] * along2)
}
