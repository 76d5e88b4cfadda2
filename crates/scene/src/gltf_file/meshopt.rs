//! Buffer views compressed by EXT_meshopt_compression, decoded by the crate `meshopt`.

use meshopt::{decode_filter_exp, decode_index_buffer, decode_index_sequence, decode_vertex_buffer};
use serde::Deserialize;

/// Most bytes that a byte of attributes makes: two bits stand for a byte of each of 16 elements, all as in the element before.
const MOST_PER_BYTE: usize = 64;

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
        // The decoder allocates all of a view before it looks at the data.
        if self.decoded_length()? / MOST_PER_BYTE > data.len() {
            return None;
        }
        let narrowed = |indices: Vec<u32>| {
            indices.iter().flat_map(|index| index.to_le_bytes().into_iter().take(stride)).collect()
        };
        match (self.mode, data.first()?) {
            (Mode::Attributes, 0xa0) if stride.is_multiple_of(4) => {
                let mut words = words(data, count, stride / 4)?;
                if self.filter == Filter::Exponential {
                    decode_filter_exp(words.as_chunks_mut::<1>().0);
                }
                Some(words.into_iter().flat_map(u32::to_le_bytes).collect())
            }
            (Mode::Triangles, 0xe1) if matches!(stride, 2 | 4) && count.is_multiple_of(3) => {
                decode_index_buffer(data, count).ok().map(narrowed)
            }
            (Mode::Indices, 0xd1) if matches!(stride, 2 | 4) => {
                decode_index_sequence(data, count).ok().map(narrowed)
            }
            _ => None,
        }
    }
}

/// An element of `N` words.
#[derive(Clone)]
struct Element<const N: usize>([u32; N]);

impl<const N: usize> Default for Element<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn elements<const N: usize>(data: &[u8], count: usize) -> Option<Vec<u32>> {
    let elements: Vec<Element<N>> = decode_vertex_buffer(data, count).ok()?;
    Some(elements.into_iter().flat_map(|element| element.0).collect())
}

/// The words of `count` elements. The decoder takes the size of an element from its type.
fn words(data: &[u8], count: usize, size: usize) -> Option<Vec<u32>> {
    macro_rules! by_size {
        ($($n:literal)*) => {
            match size {
                $($n => elements::<$n>(data, count),)*
                _ => None,
            }
        };
    }
    by_size! {
        1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
        33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64
    }
}

#[cfg(test)]
mod tests {
    use meshopt::{encode_index_buffer, encode_index_sequence, encode_vertex_buffer_level};

    use super::*;

    fn view(mode: Mode, count: usize, byte_stride: usize) -> Compressed {
        let (byte_offset, byte_length) = (0, 0);
        Compressed { buffer: 0, byte_offset, byte_length, byte_stride, count, mode, filter: Filter::None }
    }

    fn bytes(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_le_bytes()).collect()
    }

    /// A view of each mode, its compressed data, and what they decode to.
    fn views() -> [(Compressed, Vec<u8>, Vec<u8>); 4] {
        let rows: Vec<[u32; 2]> =
            (0..300).map(|k| [k * k % 65521, ((k / 17) << 16) | (k / 40 * 5)]).collect();
        let attributes = encode_vertex_buffer_level(&rows, 2, Some(0)).expect("rows");
        let matrices: Vec<[u32; 16]> = (0..20).map(|k| std::array::from_fn(|i| i as u32 * k)).collect();
        let matrix_data = encode_vertex_buffer_level(&matrices, 2, Some(0)).expect("matrices");
        let fan: Vec<u32> = (1..90).flat_map(|k| [0, k, k + 1]).collect();
        let triangles = encode_index_buffer(&fan, 91).expect("a fan");
        let sequence: Vec<u32> = (0..60).map(|k| if k % 2 == 1 { 7 * k % 50 } else { 60000 + k }).collect();
        let indices = encode_index_sequence(&sequence, 70000).expect("a sequence");
        [
            (view(Mode::Attributes, 300, 8), attributes, bytes(rows.as_flattened())),
            (view(Mode::Attributes, 20, 64), matrix_data, bytes(matrices.as_flattened())),
            (view(Mode::Triangles, fan.len(), 4), triangles, bytes(&fan)),
            (view(Mode::Indices, 60, 4), indices, bytes(&sequence)),
        ]
    }

    #[test]
    fn all_modes_give_back_what_was_encoded() {
        for (view, data, expected) in views() {
            assert_eq!(view.decode(&data), Some(expected));
        }
        let [.., (indices, data, expected)] = views();
        let narrow = Compressed { byte_stride: 2, ..indices };
        let halves: Vec<u8> = expected.chunks(4).flat_map(|word| &word[..2]).copied().collect();
        assert_eq!(narrow.decode(&data), Some(halves));
    }

    #[test]
    fn exponents_and_integers_become_floats() {
        let given = [(-2, -3), (0, 0), (20, 5), (-100, 1), (3, -(1 << 23))];
        let words = given.map(|(exponent, integer)| [(exponent << 24 | integer & 0xff_ffff_i32) as u32]);
        let data = encode_vertex_buffer_level(&words, 2, Some(0)).expect("words");
        let view = Compressed { filter: Filter::Exponential, ..view(Mode::Attributes, given.len(), 4) };
        let expected = given.map(|(exponent, integer)| (integer as f32 * f32::powi(2.0, exponent)).to_bits());
        assert_eq!(view.decode(&data), Some(bytes(&expected)));
    }

    #[test]
    fn malformed_data_are_refused() {
        for (mut view, data, expected) in views() {
            // One header is not another, and cut data lack their end.
            assert_eq!(view.decode(&[&[0xb0], &data[1..]].concat()), None);
            for length in [0, 1, 9, 30, data.len() / 2, data.len() - 1] {
                assert_eq!(view.decode(&data[..length]), None);
            }
            // Whatever a byte is changed to, there are as many elements or none.
            for at in 0..data.len() {
                for bit in 0..8 {
                    let mut other = data.clone();
                    other[at] ^= 1 << bit;
                    assert!(view.decode(&other).is_none_or(|found| found.len() == expected.len()));
                }
            }
            let (stride, count) = (view.byte_stride, view.count);
            for wrong in [0, 3, 260, usize::MAX] {
                view.byte_stride = wrong;
                assert_eq!(view.decode(&data), None, "a stride of {wrong}");
            }
            view.byte_stride = stride;
            for wrong in [20 * count, 1 << 28, usize::MAX / stride] {
                view.count = wrong;
                assert_eq!(view.decode(&data), None, "{wrong} elements");
            }
        }
    }
}
