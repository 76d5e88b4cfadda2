#ifndef PIECES_GLSL
#define PIECES_GLSL
// Triangles in quarters. Twin: crates/core/src/model/facet.rs.

#include "real.glsl"

// crates/core/src/model/near_field.rs gives the reason.
const real QUARTER_RANGE = real(1.0) / 24.0;

// Distances from the plane of the source whose square is below this fraction of its characteristic area are rounding
// and count as in the plane: the two sides of a sheet do not illuminate each other.
#ifdef F64
const real COINCIDENT = 1e-24;
#else
const real COINCIDENT = 1e-12;
#endif

// The quarters of the triangle p, q, r: three at its corners, then the one in the middle.
void quarter(uint k, inout real3 p, inout real3 q, inout real3 r) {
    real3 pq = 0.5 * (p + q), qr = 0.5 * (q + r), rp = 0.5 * (r + p);
    p = k == 0 ? p : k == 1 ? pq : k == 2 ? rp : pq;
    q = k == 0 ? pq : k == 1 ? q : qr;
    r = k == 0 ? rp : k == 1 ? qr : k == 2 ? r : rp;
}

// On which sides of a plane the triangle p, q, r lies; on both if it crosses.
void sides(real3 centre, real3 normal, real3 p, real3 q, real3 r, out bool front, out bool back) {
    real3 height = real3(dot(p - centre, normal), dot(q - centre, normal), dot(r - centre, normal));
    front = max(max(height.x, height.y), height.z) > 0.0;
    back = min(min(height.x, height.y), height.z) < 0.0;
}

#endif
