//! Reads struct layouts out of SPIR-V, so that tests can compare them with the host's.

/// Name and offset in bytes of each member of the struct or block `name` of a module, in order of declaration.
pub fn member_offsets(spirv: &[u32], name: &str) -> Vec<(String, u32)> {
    use rspirv::dr::Operand::{Decoration, IdRef, LiteralBit32, LiteralString};
    use rspirv::spirv::{Decoration as Kind, Op};
    let module = rspirv::dr::load_words(spirv).unwrap();
    // A struct that is used both in a buffer and as a local variable is there twice, with offsets only in the buffer.
    let laid_out = |id: u32| {
        module.annotations.iter().any(|line| match line.operands.as_slice() {
            [IdRef(of), LiteralBit32(_), Decoration(Kind::Offset), LiteralBit32(_)] => *of == id,
            _ => false,
        })
    };
    let structure = module.debug_names.iter().find_map(|line| match line.operands.as_slice() {
        [IdRef(id), LiteralString(text)] if text == name && laid_out(*id) => Some(*id),
        _ => None,
    });
    let structure = structure.unwrap_or_else(|| panic!("the module has no struct {name}"));
    let member_name = |wanted: u32| {
        module.debug_names.iter().find_map(|line| match line.operands.as_slice() {
            [IdRef(id), LiteralBit32(member), LiteralString(text)]
                if line.class.opcode == Op::MemberName && (*id, *member) == (structure, wanted) =>
            {
                Some(text.clone())
            }
            _ => None,
        })
    };
    let mut members: Vec<_> = module
        .annotations
        .iter()
        .filter_map(|line| match line.operands.as_slice() {
            [IdRef(id), LiteralBit32(member), Decoration(Kind::Offset), LiteralBit32(offset)]
                if *id == structure =>
            {
                Some((*member, *offset))
            }
            _ => None,
        })
        .collect();
    members.sort_unstable();
    members.into_iter().map(|(member, offset)| (member_name(member).unwrap(), offset)).collect()
}
