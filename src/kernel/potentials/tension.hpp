// Strings without longitudinal motion: their direction follows from sums of one modal pass (modal/tension_pass.hpp).
#pragma once

#include "solve.hpp"

namespace tonewood {
namespace {

constexpr double kLargestAlpha = 0.5;  // of the highest mode, up to which g counts on the motion that the tension makes

class ModulatedTensions final : public PotentialGroup {
public:
    ModulatedTensions(PotentialRun& run, int first, int end) : PotentialGroup(run, first, end) {
        for (int s = first_; s < end_; ++s) {
            for (int j = 0; j < 3; ++j) ws_.past[j][s] = row(s)[j];
            ws_.psi[s] = 0.5 * t_.two_way[s].root * stretch(s) + row(s)[3];
        }
    }

    double excursion(int i) const override {
        const int s = t_.parts[run_.part_of[i]].potential;
        const double size = std::sqrt(0.5 * std::max(ws_.spread[s], 0.0)) + ws_.bound[s];
        return std::abs(ws_.mean[s]) * t_.two_way[s].root * size * (1 + 1e-9);
    }

    ContactSums contact(int i, int port) const override {
        const PotentialPart& part = run_.parts[run_.part_of[i]];
        const int s = part.part->potential;
        TensionMade begun = now_[s];
        begun.alone = ws_.driven.data() + part.part->first_port;
        ContactSums out = contact_sums(*part.c, part.state, port, begun);
        out.reach *= t_.two_way[s].root;
        return out;
    }

    void begin_step() override {
        for (int s = first_; s < end_; ++s) {
            const Potentials::One& string = t_.two_way[s];
            const double next = 3 * (ws_.past[0][s] - ws_.past[1][s]) + ws_.past[2][s];
            const double most = string.highest > 0.0 ? kLargestAlpha / string.highest : 0.0;
            now_[s].ahead = std::min(std::max(next, 0.0), most);
        }
    }
    void sum(const PotentialPart& part, double* to) override {
        sum_tension_step(*part.c, part.state, now_[part.part->potential].ahead, to);
    }
    void make(const PotentialPart& part) override {
        TensionMade made = then_[part.part->potential];
        made.alone = ws_.driven.data() + part.part->first_port, made.found = ws_.forces.data() + part.part->first_port;
        make_tension_step(*part.c, part.state, made);
    }

    void direct() override {
        for (int s = first_; s < end_; ++s) direct(s);
    }

    void end_step() override {
        for (int s = first_; s < end_; ++s) {
            ws_.past[2][s] = ws_.past[1][s], ws_.past[1][s] = ws_.past[0][s];
            now_[s].tension = ws_.past[0][s] = t_.two_way[s].root * ws_.mean[s];
            ws_.psi[s] = 2 * ws_.mean[s] - ws_.psi[s];
        }
        then_ = now_;
    }

    // Puts psi back to sqrt(kappa) S where it `resets`.
    void keep(int s, bool resets) override {
        const double root = 0.5 * t_.two_way[s].root * stretch(s);
        if (resets) {
            const double before = ws_.psi[s], cost = 0.5 * (root - before) * (root + before);
            const double paid = pay_from_motion(
                [&](const auto& use) {
                    for (const int i : t_.two_way[s].components) use(i, std::size_t(components_[i].n));
                },
                cost);
            if (paid != 0.0) ws_.psi[s] = paid == cost ? root : std::sqrt(before * before + 2 * paid);
        }
        for (int j = 0; j < 3; ++j) row(s)[j] = ws_.past[j][s];
        row(s)[3] = ws_.psi[s] - root;
    }

private:
    // Finds ws.own and ws.reach of string s along its direction, and the right side of its equation in ws.alone.
    void direct(int s) {
        const Potentials::One& string = t_.two_way[s];
        const double* const f = ws_.driven.data() + string.first;
        const double* const answering = ws_.answering.data() + string.first;
        const double T = now_[s].ahead, root = string.root;
        double* const reach = ws_.reach.data() + string.first;
        double power = 0.0, own = 0.0, spread = 0.0, bound = 0.0, answered = 0.0;
        for (int i = string.first_part; i < string.first_part + int(string.components.size()); ++i) {
            const Potentials::Part& part = t_.parts[i];
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
        ws_.own[s] = root * root * own;
        ws_.spread[s] = spread, ws_.bound[s] = bound;
        ws_.alone[s] = ws_.psi[s] + 0.5 * (root * power + answered);
    }

    // S of a string in the state of the run.
    double stretch(int s) const {
        double sum = 0.0;
        for (const int i : t_.two_way[s].components) {
            const Component& c = components_[i];
            for (int k = 0; k < c.n; ++k) {
                const double y = c.coordinates.reading[k] * block_.x(i)[k];
                sum += c.coordinates.a[k] * y * y;
            }
        }
        return sum;
    }

    std::vector<TensionMade> now_ = std::vector<TensionMade>(t_.two_way.size()), then_ = now_;  // by string
};

}  // namespace
}  // namespace tonewood
