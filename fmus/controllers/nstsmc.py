"""Non-singular terminal sliding mode control, after Liu et al. (2020) as the thesis gives it."""

import casadi as ca
from uuv import ETA, Parameter, Signal, State
from uuv.controller import ModelBasedController, no_pitch
from uuv.kinematics import jacobian
from uuv.signals import POSITIVE

CONTROLLED = ca.DM(no_pitch(1.0))


class NSTSMC(ModelBasedController):
    """Non-singular terminal sliding mode control with adaptation.

    With e_1 = eta - eta_d, e_2 = eta_dot - eta_d_dot (thesis section 4.4.1, which swaps them), axis by axis:
    S = e_2 + beta F(e_1),  F = sqrt|A| 4 cosh^2(e/2) sign e,  A = tanh(e/2), and inside |e| <= eps a smooth
    F = A_1 sin(pi e/(2 eps)) + (eps/2pi) A_2 sin(2pi e/eps) with A_1 = F(eps), A_2 = F'(eps);
    eta_ddot = eta_d_ddot - beta F'(e_1) e_2 - alpha_1 S - alpha_2 |S|^gamma sign S - (L^T Theta/(2 eps_0)) S,
    Theta = [1, |eta_dot|, |eta_dot|^2],
    L_dot = (|S|^2/(2 eps_0^2) Theta - K_m^2 L)/lambda_m,  K_m_dot = -K_m/lambda_p,
    tau = M J^-1 (eta_ddot - J_dot nu) + C nu + D nu + g.
    Conditions: a bounded disturbance that L^T Theta comes to dominate brings S to zero in finite time; there
    e_1 vanishes within sqrt(tanh(|e_0|/2))/beta <= 1/beta.  Held it is stable up to 10 ms on bluerov2_thesis.
    """

    L = State(Signal(("1", "2", "3"), "1", "adaptive bound of the disturbance"))
    K_m = State(Signal((), "1", "forgetting of the adaptation"))
    beta = Parameter(0.5, "1/s", "gain of the terminal term (Table 5.8)")
    eps = Parameter(0.01, "1", "half width of the smooth part (Table 5.8: epsilon_1)", limits=POSITIVE)
    eps_0 = Parameter(2.0, "1", "width of the adaptive term (Table 5.8)")
    gamma = Parameter(2 / 3, "1", "exponent of the reaching law (Table 5.8)")
    alpha_1 = Parameter((5.0, 5.0, 5.0, 30.0, 0.0, 30.0), "1/s", "linear reaching gain (Table 5.8)", ETA.axes)
    alpha_2 = Parameter((5.0, 5.0, 5.0, 30.0, 0.0, 30.0), "1/s", "power reaching gain (Table 5.8)", ETA.axes)
    lambda_m = Parameter(0.5, "s", "time constant of L (Table 5.8)", limits=POSITIVE)
    lambda_p = Parameter(0.5, "s", "time constant of K_m (Table 5.8)", limits=POSITIVE)
    L_0 = Parameter((2.5, 0.5, 0.5), "1", "L at the start (Table 5.8)")
    K_m0 = Parameter(0.1, "1", "K_m at the start, diagonal (Table 5.8)")
    clamp = Parameter(6.0, "1", "largest |e_1| in F, against overflow of cosh; our choice")

    def initial(self):
        return {"L": self.L_0, "K_m": self.K_m0}

    def step(self, t, h):
        e_1, e_2 = self.errors()
        eta_dot = jacobian(self.eta) @ self.nu
        F, F_prime = terminal(ca.fmin(self.clamp, ca.fmax(-self.clamp, e_1)), self.eps)
        S = CONTROLLED * (e_2 + self.beta * F)
        speed = ca.norm_2(eta_dot)
        Theta = ca.vertcat(1, speed, speed**2)
        reaching = self.alpha_1 * S + self.alpha_2 * ca.fabs(S) ** self.gamma * ca.sign(S)
        adaptive = ca.dot(self.L, Theta) / (2 * self.eps_0) * S
        eta_ddot = self.eta_d_ddot - CONTROLLED * self.beta * F_prime * e_2 - reaching - adaptive
        L_dot = (ca.sumsqr(S) / (2 * self.eps_0**2) * Theta - self.K_m**2 * self.L) / self.lambda_m
        return {
            "tau": self.inverse_dynamics(eta_ddot),
            "L": self.L + h * L_dot,
            "K_m": self.K_m - h * self.K_m / self.lambda_p,
        }


def terminal(e, eps):
    """F(e) and F'(e) of the non-singular terminal surface (thesis Eqs. 4.28, 4.32), entry by entry.

    4.32 prints a spurious eps/2pi in the inner branch.  e: (n,).  Returns two (n,).
    """

    def outer(size):
        root = ca.sqrt(ca.tanh(size / 2))
        return root * 4 * ca.cosh(size / 2) ** 2, 1 / root + 2 * root * ca.sinh(size)

    A_1, A_2 = outer(eps)
    inside = ca.fabs(e) <= eps
    F_outer, F_prime_outer = outer(ca.fmax(ca.fabs(e), eps))
    F_inner = A_1 * ca.sin(ca.pi * e / (2 * eps)) + eps / (2 * ca.pi) * A_2 * ca.sin(2 * ca.pi * e / eps)
    F_prime_inner = ca.pi / (2 * eps) * A_1 * ca.cos(ca.pi * e / (2 * eps)) + A_2 * ca.cos(2 * ca.pi * e / eps)
    return (
        ca.if_else(inside, F_inner, F_outer * ca.sign(e)),
        ca.if_else(inside, F_prime_inner, F_prime_outer),
    )
