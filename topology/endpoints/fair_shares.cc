#include <algorithm>
#include <cstdint>
#include <string_view>

#include <iotcloud/topology/endpoints/fair_shares.h>

namespace iotcloud::topology {

namespace {

/// FNV-1a and MurmurHash3's last step: the same in every process and version.
std::uint64_t hash(std::string_view text, std::uint64_t seed) {
  std::uint64_t h = 0xcbf29ce484222325ULL ^ seed;
  for (const char c : text) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001b3ULL;
  h = (h ^ (h >> 33)) * 0xff51afd7ed558ccdULL;
  h = (h ^ (h >> 33)) * 0xc4ceb9fe1a85ec53ULL;
  return h ^ (h >> 33);
}

}  // namespace

std::map<std::string, std::string> fair_shares(std::vector<std::string> units,
                                               const std::vector<std::string>& workers) {
  const auto in_hash_order = [](const std::string& a, const std::string& b) {
    const auto ha = hash(a, 0), hb = hash(b, 0);
    return ha != hb ? ha < hb : a < b;
  };
  std::sort(units.begin(), units.end(), in_hash_order);

  const std::size_t least = units.size() / workers.size();
  std::size_t with_one_more = units.size() % workers.size();  // so many workers may have least + 1
  std::map<std::string, std::size_t> load;
  std::map<std::string, std::string> shares;
  for (const auto& unit : units) {
    const std::string* best = nullptr;
    std::uint64_t best_score = 0;
    for (const auto& worker : workers) {
      const std::size_t has = load[worker];
      if (has > least || (has == least && with_one_more == 0)) continue;
      const std::uint64_t score = hash(worker, hash(unit, 1));
      if (best == nullptr || score > best_score || (score == best_score && worker < *best)) {
        best = &worker;
        best_score = score;
      }
    }
    if (load[*best]++ == least) --with_one_more;
    shares[unit] = *best;
  }
  return shares;
}

}  // namespace iotcloud::topology
