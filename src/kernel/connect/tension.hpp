// Strings without longitudinal motion: their direction follows from sums of one modal pass (modal/tension_pass.hpp).
#pragma once

#include "rising.hpp"

namespace tonewood {
namespace {

constexpr double kLargestAlpha = 0.5;  // of the highest mode, up to which g counts on the motion that the tension makes

class ModulatedTensions final : public RisingTensions {
public:
    explicit ModulatedTensions(Block& block) : RisingTensions(block) {
        for (int s = 0; s < n_strings(); ++s) {
            for (int j = 0; j < 3; ++j) ws_.past[j][s] = row(s)[j];
            ws_.psi[s] = 0.5 * t_.strings[s].root * stretch(s) + row(s)[3];
        }
    }

    double excursion(int i) const override {
        const int s = string_of(i);
        const double size = std::sqrt(0.5 * std::max(ws_.spread[s], 0.0)) + ws_.bound[s];
        return std::abs(ws_.mean[s]) * t_.strings[s].root * size * (1 + 1e-9);
    }

    ContactSums contact(int i, int port) const override {
        const int s = string_of(i);
        const Polarization& part = states_[part_of_[i]];
        TensionMade begun = now_[s];
        begun.alone = ws_.driven.data() + part.part->first_port;
        ContactSums out = contact_sums(*part.c, part.state, port, begun);
        out.reach *= t_.strings[s].root;
        return out;
    }

protected:
    void begin_step() override {
        for (int s = 0; s < n_strings(); ++s) {
            const Tensions::String& string = t_.strings[s];
            const double next = 3 * (ws_.past[0][s] - ws_.past[1][s]) + ws_.past[2][s];
            const double most = string.highest > 0.0 ? kLargestAlpha / string.highest : 0.0;
            now_[s].ahead = std::min(std::max(next, 0.0), most);
        }
    }
    void sum(const Polarization& part, double* to) override {
        sum_tension_step(*part.c, part.state, now_[part.part->string].ahead, to);
    }
    void make(const Polarization& part) override {
        TensionMade made = then_[part.part->string];
        made.alone = ws_.driven.data() + part.part->first_port, made.found = ws_.forces.data() + part.part->first_port;
        make_tension_step(*part.c, part.state, made);
    }

    void direct() override {
        for (int s = 0; s < n_strings(); ++s) direct(s);
    }

    void end_step() override {
        std::swap(ws_.past[2], ws_.past[1]), std::swap(ws_.past[1], ws_.past[0]);
        for (int s = 0; s < n_strings(); ++s) {
            now_[s].tension = ws_.past[0][s] = t_.strings[s].root * ws_.mean[s];
            ws_.psi[s] = 2 * ws_.mean[s] - ws_.psi[s];
        }
        then_ = now_;
    }

    // Puts psi back to sqrt(kappa) S where it `resets`.
    void keep(int s, bool resets) override {
        const double root = 0.5 * t_.strings[s].root * stretch(s);
        if (resets) {
            const double before = ws_.psi[s], cost = 0.5 * (root - before) * (root + before);
            const double paid = pay_from_motion(
                [&](const auto& use) {
                    for (const int i : t_.strings[s].components) use(i, std::size_t(components_[i].n));
                },
                cost);
            if (paid != 0.0) ws_.psi[s] = paid == cost ? root : std::sqrt(before * before + 2 * paid);
        }
        for (int j = 0; j < 3; ++j) row(s)[j] = ws_.past[j][s];
        row(s)[3] = ws_.psi[s] - root;
    }

private:
    // Finds own_ and ws.reach of string s along its direction, and the right side of its equation in ws.alone.
    void direct(int s) {
        const Tensions::String& string = t_.strings[s];
        const double* const f = ws_.driven.data() + string.first;
        const double* const answering = ws_.answering.data() + string.first;
        const double T = now_[s].ahead, root = string.root;
        double* const reach = ws_.reach.data() + string.first;
        double power = 0.0, own = 0.0, spread = 0.0, bound = 0.0, answered = 0.0;
        for (int i = string.first_part; i < string.first_part + int(string.components.size()); ++i) {
            const Tensions::Part& part = t_.parts[i];
            const double* sum = ws_.sums.data() + part.sums;
            power += sum[0], own += sum[1], spread += sum[2];
            sum += kSharedSums;
            const int first = part.first_port - string.first, end = first + components_[part.component].n_ports;
            for (int p = first; p < end; ++p, sum += kPortSums) {
                double moved = sum[3], crossed = 2 * sum[4];
                for (int q = first; q < end; ++q) {
                    const auto& once = string.once[p * string.n + q];
                    const auto& twice = string.twice[p * string.n + q];
                    moved += f[q] * (once[0] + T * once[1]);
                    crossed += f[q] * (twice[0] + T * (twice[1] + T * twice[2]));
                }
                power += f[p] * sum[2], own += f[p] * crossed;
                reach[p] = root * moved, answered += answering[p] * reach[p];
                bound += std::abs(f[p]) * string.steady[p];
            }
        }
        own_[s] = root * root * own;
        ws_.spread[s] = spread, ws_.bound[s] = bound;
        ws_.alone[s] = ws_.psi[s] + 0.5 * (root * power + answered);
    }

    // S of a string in the state of the run.
    double stretch(int s) const {
        double sum = 0.0;
        for (const int i : t_.strings[s].components) {
            const Component& c = components_[i];
            for (int k = 0; k < c.n; ++k) {
                const double y = c.tension.reading[k] * block_.x(i)[k];
                sum += c.tension.a[k] * y * y;
            }
        }
        return sum;
    }

    std::vector<TensionMade> now_ = std::vector<TensionMade>(t_.strings.size()), then_ = now_;  // by string
};

}  // namespace
}  // namespace tonewood
