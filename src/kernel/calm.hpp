// Contacts that nothing can reach for kWeave blocks: a bound by energy, so that their strings may stay woven.
//
// A mode that a port reads as u, with its static compliance c and its frequency w, carries
//
//     V = (u^2 + (u'/w)^2) / 2c,      V(t + h) <= V(t) + F (u(t + h) - u(t)),
//
// under a force F held over a step: the work of the force is exact, since the propagator is, and what damping takes
// away is left in. So the energy V of a string of one port is bounded sample by sample from what is known anyhow.
// Another place of it reads each mode as a u + b u'/w, hence by Cauchy-Schwarz, for any number L,
//
//     |row| <= L |u| + sqrt(2 D V),   D = sum c ((a - L)^2 + b^2).
//
// With L as the string leans when its port is moved slowly, D is the compliance at that place while the port is fast.
// A group of contacts is calm for a window if the energies of its strings leave it room; the step in which one
// passes what it was given is looked at again the other way (nonlinear.hpp).
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "simd.hpp"

namespace tonewood {
namespace {

constexpr double kEnergyMargin = 1e-6;  // room for rounding and for how exactly modes are known, relative

template <class T>
double energy(const Component<T>& c, const T* x, const T* y) {
    using S = Simd<T>;
    const T *of_x = c.guarded.energy.data(), *of_y = of_x + c.n;
    typename S::V sum{}, more{};
    for (int k = 0; k < c.n; k += S::width) {
        const auto a = S::load(x + k), b = S::load(y + k);
        sum += S::load(of_x + k) * a * a;
        more += S::load(of_y + k) * b * b;
    }
    return S::sum(sum + more);
}

template <class T>
class Calm {
    using S = Simd<double>;

public:
    Calm(const std::vector<Component<T>>& components, const Layout& layout, const Nonlinear& nl)
        : components_(components), layout_(layout), nl_(nl), calm_(nl.groups.size(), 0) {
        if (!nl_.k) return;
        energy_.assign(layout_.single_width, 0.0), after_ = energy_;
        most_.assign(layout_.single_width, std::numeric_limits<double>::infinity()), sway_ = most_;
        worth_ = nl_.worth;
    }

    bool any() const { return count_ > 0; }
    bool all() const { return count_ == int(calm_.size()); }
    bool operator[](int group) const { return calm_[group]; }
    // what a newton at a port takes of the tightest slack where contacts are bounded block by block, as Nonlinear::worth
    const double* worth() const { return worth_.data(); }

    // A window begins in the state of `job`. Group g may be calm if `may(g)`; `modes` are those of the job.
    template <class May>
    void begin(const Job<T>& job, const May& may) {
        for (int g = 0; g < int(calm_.size()); ++g) {
            release(g);
            if (!nl_.groups[g].calm || !may(g)) continue;
            const Nonlinear::Group& group = nl_.groups[g];
            const std::size_t n = group.components.size();
            double taken = 0.0;
            for (std::size_t q = 0; q < n; ++q) {
                const int i = group.components[q], lane = layout_.port[i];
                const std::size_t offset = components_[i].offset;
                energy_[lane] = energy(components_[i], job.modes[0] + offset, job.modes[1] + offset);
                taken += share(group, q, energy_[lane]);
            }
            const double spare = 1.0 - kEnergyMargin - taken;
            if (!(spare > 0.0)) continue;
            for (std::size_t q = 0; q < n; ++q) {
                const int lane = layout_.port[group.components[q]];
                const double part = (share(group, q, energy_[lane]) + spare / double(n)) / group.strain[q];
                most_[lane] = part * part, sway_[lane] = group.sway[q], worth_[lane] = 0.0;
            }
            calm_[g] = 1, ++count_;
        }
    }

    // No group is calm.
    void end() {
        for (int g = 0; count_ && g < int(calm_.size()); ++g) release(g);
    }

    void release(int g) {
        for (const int i : nl_.groups[g].components) {
            const int lane = layout_.port[i];
            if (!nl_.groups[g].calm) break;
            energy_[lane] = 0.0, most_[lane] = sway_[lane] = std::numeric_limits<double>::infinity();
            worth_[lane] = nl_.worth[lane];
        }
        count_ -= calm_[g], calm_[g] = 0;
    }

    // Energies after a step under port forces `now`, between the line at its beginning and the free one after it; false
    // if one passes what it was given.
    bool meets(const double* line, const double* now) {
        S::V least{};
        for (int p = 0; p < layout_.single_width; p += S::width) {
            const S::V force = S::load(now + p);
            const S::V u = S::load(line + layout_.width + p) + S::load(&layout_.single_history[p]) * force;
            const S::V next = S::load(&energy_[p]) + force * (u - S::load(line + p));
            S::store(&after_[p], next);
            const S::V size = u < 0.0 ? -u : u;
            const S::V left = S::load(&most_[p]) - next, room = S::load(&sway_[p]) - size;
            least = left < least ? left : least;
            least = room < least ? room : least;
        }
        return !(S::sum(least) < 0.0);
    }

    // Of a group, as `meets` found.
    bool passed(int g, const double* line, const double* now) const {
        for (const int i : nl_.groups[g].components) {
            const int p = layout_.port[i];
            const double u = line[layout_.width + p] + layout_.single_history[p] * now[p];
            if (!(after_[p] <= most_[p]) || !(std::abs(u) <= sway_[p])) return true;
        }
        return false;
    }

    // The step stands.
    void commit() { std::swap(energy_, after_); }

private:
    static double share(const Nonlinear::Group& group, std::size_t q, double energy) {
        return std::sqrt(std::max(energy, 0.0)) * group.strain[q];
    }

    const std::vector<Component<T>>& components_;
    const Layout& layout_;
    const Nonlinear& nl_;
    std::vector<char> calm_;
    int count_ = 0;
    Array<double> energy_, after_, most_, sway_;  // (single_width): by port
    Array<double> worth_;                         // (force_width)
};

}  // namespace
}  // namespace tonewood
