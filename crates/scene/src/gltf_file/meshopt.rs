//! Buffer views compressed by EXT_meshopt_compression, decoded as the appendices A and B of its specification (Khronos, ratified) say.

use serde::Deserialize;

/// Largest number of bytes of an element.
const MOST_STRIDE: usize = 256;

/// The extension of a buffer view.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compressed {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: usize,
    pub byte_length: usize,
    byte_stride: usize,
    count: usize,
    mode: Mode,
    #[serde(default)]
    filter: Filter,
}

#[derive(Clone, Copy, Deserialize, PartialEq)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Clone, Copy, Default, Deserialize, PartialEq)]
#[serde(rename_all = "UPPERCASE")]
enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
}

impl Compressed {
    /// The extension of a view, if it has it.
    ///
    /// # Errors
    /// Fails if the extension is malformed.
    pub fn of(view: &gltf::buffer::View) -> Result<Option<Self>, String> {
        let Some(value) = view.extension_value("EXT_meshopt_compression") else { return Ok(None) };
        let read = Self::deserialize(value);
        read.map(Some).map_err(|error| format!("buffer view {}: {error}", view.index()))
    }

    /// True for normals, tangents and rotations, which nothing here reads.
    pub fn is_direction(&self) -> bool {
        matches!(self.filter, Filter::Octahedral | Filter::Quaternion)
    }

    /// Bytes of the view that was compressed, or `None` if they are more than can be counted.
    pub fn decoded_length(&self) -> Option<usize> {
        self.count.checked_mul(self.byte_stride)
    }

    /// The bytes of the view, or `None` if the compressed data are malformed.
    pub fn decode(&self, data: &[u8]) -> Option<Vec<u8>> {
        let (count, stride) = (self.count, self.byte_stride);
        let of_indices = |indices: Vec<u32>| {
            indices.iter().flat_map(|index| index.to_le_bytes().into_iter().take(stride)).collect()
        };
        match self.mode {
            Mode::Attributes if stride.is_multiple_of(4) && (4..=MOST_STRIDE).contains(&stride) => {
                let mut bytes = attributes(data, count, stride)?;
                if self.filter == Filter::Exponential {
                    bytes.as_chunks_mut().0.iter_mut().for_each(exponential);
                }
                Some(bytes)
            }
            Mode::Triangles if matches!(stride, 2 | 4) && count.is_multiple_of(3) => {
                triangles(data, count / 3).map(of_indices)
            }
            Mode::Indices if matches!(stride, 2 | 4) => indices(data, count).map(of_indices),
            _ => None,
        }
    }
}

/// The next bytes.
fn take<'a>(data: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, rest) = data.split_at_checked(count)?;
    *data = rest;
    Some(taken)
}

/// The data between a header byte and a tail, and the tail.
fn body(data: &[u8], header: u8, tail: usize) -> Option<(&[u8], &[u8])> {
    let (_, data) = data.split_first().filter(|(first, _)| **first == header)?;
    data.split_at_checked(data.len().checked_sub(tail)?)
}

/// Signed numbers alternate with their opposites: 0, -1, 1, -2 …
fn signed(x: u32) -> u32 {
    if x & 1 == 1 { !(x >> 1) } else { x >> 1 }
}

/// Mode 0: each byte of an element as the difference from that of the element before, in blocks and groups of 16.
fn attributes(data: &[u8], count: usize, stride: usize) -> Option<Vec<u8>> {
    let (mut data, tail) = body(data, 0xa0, stride.max(32))?;
    let mut last = tail[tail.len() - stride..].to_vec();
    let mut elements = Vec::new();
    let most = (8192 / stride / 16 * 16).min(256);
    for first in (0..count).step_by(most) {
        let block = most.min(count - first);
        let start = elements.len();
        elements.resize(start + block * stride, 0);
        for (at, last) in last.iter_mut().enumerate() {
            let groups = block.div_ceil(16);
            let modes = take(&mut data, groups.div_ceil(4))?;
            for group in 0..groups {
                let deltas = deltas(&mut data, modes[group / 4] >> (2 * (group % 4)) & 3)?;
                for (element, delta) in (16 * group..block).zip(deltas) {
                    *last = last.wrapping_add(signed(delta.into()) as u8);
                    elements[start + element * stride + at] = *last;
                }
            }
        }
    }
    Some(elements)
}

/// A group of mode 0. Numbers of few bits are the largest of their kind where a whole byte follows.
fn deltas(data: &mut &[u8], mode: u8) -> Option<[u8; 16]> {
    let bits = match mode {
        0 => return Some([0; 16]),
        1 => 2,
        2 => 4,
        _ => return take(data, 16)?.try_into().ok(),
    };
    let packed = take(data, 2 * bits)?;
    let most = (1 << bits) - 1;
    let mut deltas = [0; 16];
    for (k, delta) in deltas.iter_mut().enumerate() {
        *delta = packed[k * bits / 8] >> (8 - bits - k * bits % 8) & most;
        if *delta == most {
            *delta = take(data, 1)?[0];
        }
    }
    Some(deltas)
}

/// A number in bytes of 7 bits, the last of them below 128.
fn varint(data: &mut &[u8]) -> Option<u32> {
    let mut number = 0;
    for shift in (0..35).step_by(7) {
        let byte = take(data, 1)?[0];
        number |= u32::from(byte & 127) << shift;
        if byte < 128 {
            return Some(number);
        }
    }
    None
}

/// The last 16 things; 0 is the latest.
#[derive(Default)]
struct Recent<T> {
    things: [T; 16],
    next: usize,
}

impl<T: Copy> Recent<T> {
    fn push(&mut self, thing: T) {
        self.things[self.next % 16] = thing;
        self.next += 1;
    }

    fn at(&self, back: u8) -> T {
        self.things[self.next.wrapping_sub(1 + usize::from(back)) % 16]
    }
}

/// What mode 1 remembers from triangle to triangle.
#[derive(Default)]
struct Strip {
    /// The lowest vertex not met so far.
    next: u32,
    /// The vertex last written as a number.
    last: u32,
    vertices: Recent<u32>,
    edges: Recent<[u32; 2]>,
}

impl Strip {
    fn new_vertex(&mut self) -> u32 {
        self.next = self.next.wrapping_add(1);
        self.next.wrapping_sub(1)
    }

    fn written(&mut self, data: &mut &[u8]) -> Option<u32> {
        self.last = self.last.wrapping_add(signed(varint(data)?));
        Some(self.last)
    }

    /// A vertex by four bits: a new one, a recent one, or one that is written, and whether it joins the recent ones.
    fn vertex(&mut self, bits: u8, data: &mut &[u8]) -> Option<(u32, bool)> {
        match bits {
            0 => Some((self.new_vertex(), true)),
            15 => Some((self.written(data)?, true)),
            _ => Some((self.vertices.at(bits - 1), false)),
        }
    }

    /// The third vertex beside a recent edge.
    fn beside(&mut self, edge: u8, bits: u8, data: &mut &[u8]) -> Option<[u32; 3]> {
        let [a, b] = self.edges.at(edge);
        let (c, joins) = match bits {
            1..=12 => (self.vertices.at(bits), false),
            13 | 14 => {
                self.last = if bits == 13 { self.last.wrapping_sub(1) } else { self.last.wrapping_add(1) };
                (self.last, true)
            }
            _ => self.vertex(bits, data)?,
        };
        if joins {
            self.vertices.push(c);
        }
        Some([a, b, c])
    }

    /// Three vertices by four bits each.
    fn apart(&mut self, bits: [u8; 3], data: &mut &[u8]) -> Option<[u32; 3]> {
        let [a, b, c] = bits;
        let corners = [self.vertex(a, data)?, self.vertex(b, data)?, self.vertex(c, data)?];
        corners.iter().filter(|(_, joins)| *joins).for_each(|&(vertex, _)| self.vertices.push(vertex));
        let [a, b, c] = corners.map(|(vertex, _)| vertex);
        self.edges.push([b, a]);
        Some([a, b, c])
    }
}

/// Mode 1: a byte for each triangle, which mostly shares an edge with a recent one.
fn triangles(data: &[u8], count: usize) -> Option<Vec<u32>> {
    let (data, table) = body(data, 0xe1, 16)?;
    let (codes, mut data) = data.split_at_checked(count)?;
    let mut strip = Strip::default();
    let mut corners = Vec::with_capacity(3 * count);
    for &code in codes {
        let (high, low) = (code >> 4, code & 15);
        let triangle = match (high, low) {
            (15, 14 | 15) => {
                let bits = take(&mut data, 1)?[0];
                if bits == 0 {
                    strip.next = 0;
                }
                strip.apart([if low == 14 { 0 } else { 15 }, bits >> 4, bits & 15], &mut data)?
            }
            (15, _) => {
                let bits = table[usize::from(low)];
                strip.apart([0, bits >> 4, bits & 15], &mut data)?
            }
            _ => strip.beside(high, low, &mut data)?,
        };
        let [a, b, c] = triangle;
        strip.edges.push([c, b]);
        strip.edges.push([a, c]);
        corners.extend(triangle);
    }
    Some(corners)
}

/// Mode 2: differences from one of two numbers.
fn indices(data: &[u8], count: usize) -> Option<Vec<u32>> {
    let (mut data, _) = body(data, 0xd1, 4)?;
    let mut last = [0u32; 2];
    let next = |_| {
        let number = varint(&mut data)?;
        let last = &mut last[(number & 1) as usize];
        *last = last.wrapping_add(signed(number >> 1));
        Some(*last)
    };
    (0..count).map(next).collect()
}

/// Filter 3: 8 bits of an exponent over 24 of an integer become a float.
fn exponential(bytes: &mut [u8; 4]) {
    let bits = i32::from_le_bytes(*bytes);
    *bytes = ((bits << 8 >> 8) as f32 * f32::powi(2.0, bits >> 24)).to_le_bytes();
}

/// Data that the encoder of meshoptimizer 1.0 made.
#[cfg(test)]
mod tests {
    use super::*;

    const ATTRIBUTES: &str = "oP////8AAgYKDhIWGh4iJiouMjY6PkJGSk5SVlpeYmZqbnJ2en6ChoqOkpaanqKmqq6ytrq+wsbKztLW2t7i5uru8vb6/v359fHt6eXh3dnV0c3JxcG9ubWxramloZ2ZlZGNiYWBfXl1cW1pZWFdWVVRTUlFQT05NTEtKSUhHRkVEQ0JBQECBgoOEhYaHiImKi4yNjo+QkZKTlJWWl5iZmpucnZ6foKGio6SlpqeoqaqrrK2ur7CxsrO0tba3uLm6u7y9vr+/fn18e3p5eHd2dXRzcnFwb25tbGtqaWhnZmVkY2JhYF9eXVxbWllYV1ZVVFNSUVBPTk1MS0pJSEdGRURDQkFVFWlqoACAICAgIIIggiIiIiIiKKIooqKioqiqoqqqqqqqqqq6quq6gQEBEIiQiJCJCJCQiQiQkJCQkJCQkJCQkJEJEJCRCRCREJEQkRCREQkRERCRERERERERKqqqqoGZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZmZgAEEAAACAAAAAACAFRVVVUgAAAACAAAAAIAAAAAgAAAACAAAAAIAAAAAgAAAACAAAAAIAAAAAgAAAACAAAAAIAAAAAgAAAACAAAAAIAAAAAEEQQQQAAwAAKwAAAAAoAAMAACsAAAAAKAADAAArAAAAACgAAAAA/HAIGCg4SFhoeIiYqLjI2Oj5CRkpOUlZaXmJmam5ydnp+goaKjpKWmp6ipqoAAAAAKkREREREREREZERERkREZERkRGRGREYAACpmZmZmZmZmZmZmZmZmZmZmZmZmZmZmAAABgAAAABSAAAAAIAAAAAAEAADAAAoAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=";
    const TRIANGLES: &str = "4fAA/hP+Ev4S/hL+Ev4S/hL+Ev4S/hL+Ev4g/iX+I/4j/iP+I/4j/iP+I/4j/iP+I/4g/iX+I/4j/iP+I/4j/iP+I/4j/iP+I/4g/iX+I/4j/iP+I/4j/iP+I/4j/iP+I/4g/iX+I/4j/iP+I/4j/iP+I/4j/iP+I/4g/iX+I/4j/iP+I/4j/iP+I/4j/iP+I///8P7/AwICAgICAgICAgL/BgEvBh8EHwQfBB8EHwQfBB8EHwQfBB8E/wQBLwQfAh8CHwIfAh8CHwIfAh8CHwIfAv8EAS8EHwIfAh8CHwIfAh8CHwIfAh8CHwL/BAEvBB8CHwIfAh8CHwIfAh8CHwIfAh8C/wQBLwQfAh8CHwIfAh8CHwIfAh8CHwIfAi+ZAVr/QYgBmQEA/8oPkLYI1cUIAHaHVmd4qYZliWiYAWkAAA==";
    const INDICES: &str = "0YHTDhwJOAk4CTgJjgEJOAk4CY4BCTgJOAk4CY4BCTgJOAmOAQk4CTgJOAmOAQk4CTgJjgEJOAk4CTgJjgEJOAk4CTgJjgEAAAAA";

    fn bytes(base64: &str) -> Vec<u8> {
        let url = format!("data:;base64,{base64}");
        data_url::DataUrl::process(&url).expect("an address").decode_to_vec().expect("base64").0
    }

    fn view(mode: Mode, count: usize, byte_stride: usize) -> Compressed {
        let (byte_offset, byte_length) = (0, 0);
        Compressed { buffer: 0, byte_offset, byte_length, byte_stride, count, mode, filter: Filter::None }
    }

    fn words(bytes: &[u8]) -> Vec<u32> {
        bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect()
    }

    /// The cells of a grid in two triangles each, vertices by their first use, and five triangles that stand alone.
    fn grid() -> Vec<u32> {
        let mut seen = Vec::new();
        let cells = (0..6).flat_map(|row| (0..12).map(move |column| 13 * row + column));
        let corners = cells.flat_map(|a| [a, a + 1, a + 14, a, a + 14, a + 13]);
        let numbered = corners.map(|corner| match seen.iter().position(|&other| other == corner) {
            Some(known) => known as u32,
            None => {
                seen.push(corner);
                seen.len() as u32 - 1
            }
        });
        let mut grid: Vec<u32> = numbered.collect();
        grid.extend([0, 90, 45, 12, 80, 3, 91, 92, 93, 0, 1, 2, 1000, 70000, 5]);
        grid
    }

    #[test]
    fn all_modes_give_back_what_was_encoded() {
        let rows: Vec<u8> = (0..300u32)
            .flat_map(|k| [k * k % 65521, 3 * k % 4096, k / 17, k / 40 * 5])
            .flat_map(|number| (number as u16).to_le_bytes())
            .collect();
        assert_eq!(view(Mode::Attributes, 300, 8).decode(&bytes(ATTRIBUTES)), Some(rows));
        let indices: Vec<u32> = (0..60).map(|k| if k % 2 == 1 { 7 * k % 50 } else { 60000 + k }).collect();
        assert_eq!(
            view(Mode::Indices, 60, 4).decode(&bytes(INDICES)).map(|found| words(&found)),
            Some(indices)
        );
        // The encoder may begin triangles at another corner.
        let found = view(Mode::Triangles, 447, 4).decode(&bytes(TRIANGLES)).expect("indices");
        let (found, grid) = (words(&found), grid());
        assert_eq!(found.len(), grid.len());
        for (found, given) in found.chunks(3).zip(grid.chunks(3)) {
            let [a, b, c] = [given[0], given[1], given[2]];
            assert!(
                [[a, b, c], [b, c, a], [c, a, b]].iter().any(|turned| turned == found),
                "{found:?} {given:?}"
            );
        }
    }

    #[test]
    fn exponents_and_integers_become_floats() {
        for (exponent, integer) in [(-2, -3), (0, 0), (20, 5), (-100, 1), (3, -(1 << 23))] {
            let mut bytes = (exponent << 24 | integer & 0xff_ffff_i32).to_le_bytes();
            exponential(&mut bytes);
            let expected = f64::from(integer) * f64::from(exponent).exp2();
            assert_eq!(f64::from(f32::from_le_bytes(bytes)), expected);
        }
    }

    #[test]
    fn malformed_data_are_refused() {
        let modes = [
            (Mode::Attributes, 300, 8, ATTRIBUTES),
            (Mode::Triangles, 447, 4, TRIANGLES),
            (Mode::Indices, 60, 4, INDICES),
        ];
        for (mode, count, stride, data) in modes {
            let data = bytes(data);
            // One header is not another, and cut data lack their end.
            let view = |stride| view(mode, count, stride);
            assert_eq!(view(stride).decode(&[&[0xb0], &data[1..]].concat()), None);
            for length in [0, 1, 9, 30, data.len() / 2] {
                assert_eq!(view(stride).decode(&data[..length]), None);
            }
            assert_eq!(view(0).decode(&data), None);
            assert_eq!(view(3).decode(&data), None);
            // Whatever a byte is changed to, there are as many elements or none.
            for at in 1..data.len() {
                let mut other = data.clone();
                other[at] ^= 0xff;
                assert!(view(stride).decode(&other).is_none_or(|found| found.len() == count * stride));
            }
        }
    }
}
