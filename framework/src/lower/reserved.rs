//! Lists the words and macros that GLSL reserves. Words cannot name a live parameter, which is a variable in shaders;
//! macros cannot name a constant, which is a macro in capitals.

use crate::ir::LIVE_BLOCK;

/// Keywords and words reserved for the future (GLSL 4.60, section 3.6), without families such as `vec3`.
#[rustfmt::skip]
const WORDS: &[&str] = &[
    "attribute", "const", "uniform", "varying", "buffer", "shared", "coherent", "volatile", "restrict",
    "readonly", "writeonly", "atomic_uint", "layout", "centroid", "flat", "smooth", "noperspective", "patch",
    "sample", "invariant", "precise", "break", "continue", "do", "for", "while", "switch", "case", "default",
    "if", "else", "subroutine", "in", "out", "inout", "int", "void", "bool", "true", "false", "float",
    "double", "discard", "return", "uint", "lowp", "mediump", "highp", "precision", "struct", "common",
    "partition", "active", "asm", "class", "union", "enum", "typedef", "template", "this", "resource", "goto",
    "inline", "noinline", "public", "static", "extern", "external", "interface", "long", "short", "half",
    "fixed", "unsigned", "superp", "input", "output", "filter", "sizeof", "cast", "namespace", "using", "sampler",
    "subpassInput",
];

/// Returns true for a macro that GLSL defines or reserves. A definition would replace it or be ignored.
pub(super) fn is_macro(name: &str) -> bool {
    name == "VULKAN" || name.starts_with("GL_") || name.starts_with("__")
}

/// Returns true for a word that GLSL reserves, and for the two names that every shader with live parameters declares.
pub(super) fn is_reserved(word: &str) -> bool {
    let size = |rest: &str| matches!(rest.as_bytes(), [b'2'..=b'4'] | [b'2'..=b'4', b'x', b'2'..=b'4']);
    let families = ["vec", "ivec", "uvec", "bvec", "dvec", "hvec", "fvec", "mat", "dmat"];
    let in_family = families.iter().any(|family| word.strip_prefix(family).is_some_and(size));
    let opaque = ["texture", "sampler", "isampler", "usampler", "image", "iimage", "uimage"];
    let dimensions =
        |rest: &str| ["1D", "2D", "3D", "Cube"].iter().any(|dimension| rest.starts_with(dimension));
    let is_opaque = opaque.iter().any(|kind| word.strip_prefix(kind).is_some_and(dimensions));
    [LIVE_BLOCK, "main"].contains(&word)
        || WORDS.contains(&word)
        || in_family
        || is_opaque
        || word.starts_with("gl_")
}

#[cfg(test)]
mod tests {
    use super::is_reserved;

    #[test]
    fn words_of_glsl_are_reserved_and_words_like_them_are_not() {
        for word in ["float", "sample", "vec3", "mat3x4", "image2D", "samplerCube", "gl_Position", "main"] {
            assert!(is_reserved(word), "{word}");
        }
        for word in ["floats", "vec", "vec1", "mat22", "image2", "texture", "radius", "mix"] {
            assert!(!is_reserved(word), "{word}");
        }
    }
}
