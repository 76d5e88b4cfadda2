#ifndef NEAR_WALK_GLSL
#define NEAR_WALK_GLSL
// The pieces of one close pair, forwards and in the adjoint. Where lanes share a target, they share each of its pairs: a lane
// takes a quarter of the receiver, and one or every other quarter of the source, and all go on together. Expects near_push.glsl, the
// constants of both ends' bins, `source_normal`, and `piece`: from a piece of the source to a point of the receiver, with the blend
// weights of the two kinds of radiance.

#include "near_field.glsl"
#include "pieces.glsl"

// The source u, v, w and the receiver a, b, c; `near`: blend weight of the near field, `range`: its range.
void walk_pieces(
    real3 source_centre, real3 u, real3 v, real3 w, real3 a, real3 b, real3 c, real near, real range
) {
    // Lanes for each quarter of the receiver.
    const uint beside = TARGETS_ARE_SHARED ? COOPERATIVE / 4 : 1;
    for (uint onto = lane_turn() / beside; onto < 4; onto += TARGETS_ARE_SHARED ? 4 : 1) {
        real3 e = a, f = b, g = c;
        quarter(onto, e, f, g);
        real3 point = (e + f + g) * (real(1.0) / 3.0);
        bool front, back;
        sides(source_centre, source_normal, e, f, g, front, back);
        bool directional = (SOURCE_FRONT && front) || (SOURCE_BACK && backs != 0 && back);
        // Without directions at either end, Lambert's formula is exact for the whole source.
        bool whole = !directional && !RECEIVER_BINS;
        uint pieces = !front && !directional ? 0 : whole ? 1 : 4;
        for (uint from = lane_turn() % beside; from < (TARGETS_ARE_SHARED ? 4 : pieces); from += beside) {
            bool taken = !TARGETS_ARE_SHARED || from < pieces;
            real wanted = taken ? near : real(0.0);
            real3 p = u, q = v, r = w;
            if (!whole) {
                quarter(from, p, q, r);
            }
            real far = 1.0;
            if (directional) {
                real3 d = point - (p + q + r) * (real(1.0) / 3.0);
                far = far_weight(dot(d, d), range * QUARTER_RANGE);
            }
            piece(p, q, r, point, wanted * 0.25, wanted * far * 0.25);
            reduce_scattered();
            for (uint finer = any_cooperative(taken && far < 1.0) ? 0 : 16; finer < 16; finer++) {
                real3 p2 = p, q2 = q, r2 = r, e2 = e, f2 = f, g2 = g;
                quarter(finer & 3, p2, q2, r2);
                quarter(finer >> 2, e2, f2, g2);
                piece(p2, q2, r2, (e2 + f2 + g2) * (real(1.0) / 3.0), 0.0, wanted * (1.0 - far) * 0.0625);
                reduce_scattered();
            }
        }
    }
}

#endif
