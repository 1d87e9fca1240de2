// The layout of spherical harmonics up to degree SH_DEGREE: three floats for each of (SH_DEGREE + 1)^2 coefficients.

#define SH_FLOATS (3 * (SH_DEGREE + 1) * (SH_DEGREE + 1))
// Planes of four floats.
#define SH_PLANES ((SH_FLOATS + 3) / 4)
// Words of four 8-bit coefficients, after the constant coefficients.
#define SH_WORDS (SH_FLOATS / 4)
