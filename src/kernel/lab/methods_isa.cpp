// Compiled once per instruction set, like isa.cpp.
#include "explicit_laws.hpp"

namespace tonewood {

extern const MethodTable TONEWOOD_ISA_TABLE;
const MethodTable TONEWOOD_ISA_TABLE = {
    TONEWOOD_ISA_NAME,
    {&run_method<Flow>, &run_method<AdamsBashforth>, &run_method<Verlet>, &run_method<Newmark>},
    &run_explicit};

}  // namespace tonewood
