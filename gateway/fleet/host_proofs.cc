#include <filesystem>

#include <iotcloud/gateway/fleet/host_proofs.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/security/private_file.h>
#include <iotcloud/security/registry_password.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

HostProofs::HostProofs(const std::string& state_folder) {
  const std::string file = state_folder + "/hosts-secret";
  constexpr std::size_t most = 1000;
  if (std::filesystem::exists(file)) secret_ = processes::read_file(file, most);
  if (security::is_sha256(secret_)) return;  // a file that is cut short is made anew: running hosts start again
  secret_ = security::random_hex();
  security::replace_private_file(file, secret_);
}

std::string HostProofs::of(const std::string& socket) const {
  return security::sha256_hex(security::sha256_hex(secret_ + " " + socket) + " " + secret_);
}

std::string HostProofs::check_of(const std::string& socket) const {
  return security::sha256_hex(of(socket));
}

}  // namespace iotcloud::gateway
