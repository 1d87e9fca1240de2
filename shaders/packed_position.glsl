// The layout of packed positions, written by pack_positions.comp and read by stored_splat.glsl: a block of 256 splats has 3 x 256
// steps of 16 bits, x, y and z of each splat in turn, two to a word, and then the least and the greatest corner of its box.

const uint STEP_WORDS = 384u;
const uint BLOCK_WORDS = STEP_WORDS + 6u;
