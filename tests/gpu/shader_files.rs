//! The compiled shaders themselves.

use antirad::scene::Precision;
use antirad::shaders::{self, Shader};

use crate::Axpy;
use crate::reflect::member_offsets;

#[test]
fn layouts_shared_with_shaders_agree() {
    let offsets = member_offsets(shaders::COMBINE.of(Precision::F32).spirv(), "Push");
    let expected = [
        ("a".to_owned(), std::mem::offset_of!(Axpy, a) as u32),
        ("b".to_owned(), std::mem::offset_of!(Axpy, b) as u32),
        ("count".to_owned(), std::mem::offset_of!(Axpy, count) as u32),
    ];
    assert_eq!(offsets, expected);
}

#[test]
fn all_shaders_are_listed() {
    let names: Vec<_> = shaders::ALL.iter().copied().map(Shader::name).collect();
    assert!(names.contains(&"combine"));
    let single: Vec<_> = names.iter().filter(|name| !name.ends_with("_f64")).collect();
    assert!(single.is_sorted(), "{names:?}");
    assert!(names.contains(&"combine_f64"));
    // Profiles and errors tell kernels apart by their names.
    let mut unique = names.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), names.len());
    // The magic number of SPIR-V.
    assert!(shaders::ALL.iter().all(|shader| shader.spirv()[0] == 0x0723_0203));
}
