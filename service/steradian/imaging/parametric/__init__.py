"""Forward model and direct inversion as functions of sensor positions, sound speed and time zero, with derivatives.

Both are one linear map K from images to A-lines of unit sensor weights: the forward model A itself
(:mod:`steradian.imaging.operators`), and the transpose of the inversion R (paper, equation 7). Voxels keep their places
in metres. With x_m the position of sensor m, t the time since the laser pulse and c the sound speed, derivatives of
K f are

    ∂/∂x_m = K_x f in row m, with the derivative of the interpolation window at the sensors,
    ∂/∂t₀  = K_t f, with the factor 2πif of each wave,
    ∂/∂c   = (ν·K f + t·K_t f + K_s f)/c, ν = 0 for A; for R, a sum over c·dt, ν = 1; K_s has the factor ∂S/∂ln c of
             the film's response S at a constant wave number,

and those of Kᵀ g have the transposes of these. The derivative by a position is that of the computed window, not of the
exact sums; the others are those of the exact sums, to the tolerance, and with a film's response to that of its table
(some 1e-5 of K_t, :func:`steradian.imaging.film_response.tabulate`).
In several layers, K_t and the derivative by each layer's speed are difference quotients of K.
"""
