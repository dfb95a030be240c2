#pragma once

#include <map>
#include <string>
#include <vector>

namespace iotcloud::topology {

/// Spreads units over workers: each worker gets as many as any other, or one less, and every process that sees the same
/// names comes to the same answer. When a unit or a worker comes or goes, few units move (rendezvous hashing with
/// bounded loads).
/// \param workers at least one. \return worker by unit.
std::map<std::string, std::string> fair_shares(std::vector<std::string> units, const std::vector<std::string>& workers);

}  // namespace iotcloud::topology
