// The layout of packed positions, written by pack_positions.comp and read by stored_splat.glsl: a block of 256 splats has 3 x 256
// 16-bit values, x, y and z of each splat interleaved, two to a word, then the minimum and the maximum corner of its box.

const uint STEP_WORDS = 384u;
const uint BLOCK_WORDS = STEP_WORDS + 6u;
