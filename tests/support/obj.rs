//! Parts of OBJ files.

/// The faces of a box from `low` to `high`, fronts outside: quads of an OBJ whose vertices start after `first`. Without the faces in
/// `but` (0 to 5: -x, +x, -y, +y, -z, +z).
pub fn block(first: usize, low: [f64; 3], high: [f64; 3], inwards: bool, but: &[usize]) -> String {
    let mut text = String::new();
    for k in 0..8 {
        let at = |axis: usize| if k >> axis & 1 == 1 { high[axis] } else { low[axis] };
        text += &format!("v {} {} {}\n", at(0), at(1), at(2));
    }
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    for (_, quad) in quads.iter().enumerate().filter(|(k, _)| !but.contains(k)) {
        let mut corners = quad.map(|v| (first + v + 1).to_string());
        if inwards {
            corners.reverse();
        }
        text += &format!("f {}\n", corners.join(" "));
    }
    text
}

/// A lamp in the plane y = `height`, facing down, or up.
pub fn lamp(first: usize, height: f64, side: f64, down: bool) -> String {
    let mut text = String::from("usemtl lamp\n");
    for [x, z] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
        text += &format!("v {} {height} {}\n", 0.5 + side / 2.0 * x, 0.5 + side / 2.0 * z);
    }
    let order = if down { [1, 2, 3, 4] } else { [4, 3, 2, 1] };
    text + &format!("f {}\n", order.map(|k| (first + k).to_string()).join(" "))
}
