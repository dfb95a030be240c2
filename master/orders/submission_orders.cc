#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/master/orders/submission_orders.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master {

std::string digest_of(const std::string& yaml, const std::vector<discovery::SentLibrary>& libraries) {
  std::string all = yaml;
  for (const auto& library : libraries) all += '\0' + library.name + '\0' + library.sha256;
  return security::sha256_hex(all);
}

std::string words(const SubmitRequest& request) {
  std::vector<std::string> libraries;
  for (const auto& library : request.libraries)
    libraries.push_back(fmt::format("{} ({})", library.file, security::short_sha256(library.sha256)));
  return fmt::format("{}, {} worker(s), libraries: {}", request.topology, request.workers,
                     libraries.empty() ? "none" : fmt::format("{}", fmt::join(libraries, ", ")));
}

std::string words(const RollbackRequest& request) {
  return request.topology;
}

}  // namespace iotcloud::master
