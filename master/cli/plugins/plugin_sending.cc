#include <filesystem>
#include <ostream>

#include <fmt/format.h>

#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t piece = std::size_t{512} * 1024;  // bytes; the size that master.thrift asks for
constexpr std::size_t worth_a_bar = std::size_t{2} << 20;
constexpr double megabyte = 1 << 20;

/// Shows on a terminal how much of a large file is sent.
class Progress {
 public:
  Progress(const std::string& file, std::size_t size, std::ostream* terminal)
      : file_(printable(file)), size_(size), terminal_(size >= worth_a_bar ? terminal : nullptr) {}
  ~Progress() {
    if (terminal_ != nullptr) *terminal_ << "\r\033[K" << std::flush;
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void at(std::size_t sent) {
    if (terminal_ == nullptr) return;
    *terminal_ << fmt::format("\rsending {}: {:.1f} of {:.1f} MB", file_, static_cast<double>(sent) / megabyte,
                              static_cast<double>(size_) / megabyte)
               << std::flush;
  }

 private:
  const std::string file_;
  const std::size_t size_;
  std::ostream* const terminal_;
};

UploadResult accepted(UploadResult answer) {
  if (answer.refusal.refusal != OrderRefusal::none) throw RequestFailed(answer.refusal.text);
  return answer;
}

InstanceOutcome failure_of(const UploadTarget& target) {
  return {target.gateway,
          {},
          OrderOutcome::failed,
          target.problem.empty() ? "it did not say that it has the plugin" : target.problem};
}

}  // namespace

namespace {

/// Sends a file's pieces to the receivers of an offer. \return the answer to the last of them
UploadResult send_pieces(UploadResult answer, const std::string& file, const std::string& bytes, MasterClient& master,
                         std::ostream* terminal) {
  const std::string upload = answer.upload;
  Progress progress(file, bytes.size(), terminal);
  for (std::size_t offset = 0; offset < bytes.size() && !answer.upload.empty(); offset += piece) {
    progress.at(offset);
    answer = accepted(master.send_plugin(upload, static_cast<std::int64_t>(offset), bytes.substr(offset, piece)));
  }
  return answer.upload.empty() ? answer : accepted(master.finish_plugin(upload));
}

PluginOffer offer_of(const std::string& path, const std::string& bytes) {
  return {fs::path(path).filename(), security::sha256_hex(bytes), static_cast<std::int64_t>(bytes.size()),
          plugin_signature(path)};
}

}  // namespace

SentPlugin send_plugin(const std::string& plugin, const std::vector<discovery::GatewayId>& gateways,
                       MasterClient& master, std::ostream* terminal) {
  SentPlugin sent;
  sent.plugin = plugin;
  if (!is_local_plugin(plugin)) return sent;
  const std::string bytes = plugin_bytes(plugin);
  const PluginOffer offer = offer_of(plugin, bytes);
  sent.plugin = offer.plugin;
  sent.sha256 = offer.sha256;
  const auto answer = send_pieces(accepted(master.offer_plugin(offer, gateways)), sent.plugin, bytes, master, terminal);
  for (const auto& target : answer.targets) {
    if (target.has) {
      sent.gateways.push_back(target.gateway);
    } else {
      sent.failures.push_back(failure_of(target));
    }
  }
  return sent;
}

SentToPools send_library(const std::string& path, MasterClient& master, std::ostream* terminal) {
  const std::string bytes = plugin_bytes(path);
  const PluginOffer offer = offer_of(path, bytes);
  const auto answer = send_pieces(accepted(master.offer_library(offer)), offer.plugin, bytes, master, terminal);
  SentToPools sent{offer.plugin, offer.sha256, {}};
  for (const auto& target : answer.targets) {
    if (!target.has) sent.failures.push_back(failure_of(target));
  }
  if (sent.failures.size() == answer.targets.size())
    throw RequestFailed(fmt::format("no pool takes {}: pool {}: {}", offer.plugin, sent.failures.front().gateway,
                                    sent.failures.front().reason));
  return sent;
}

}  // namespace iotcloud::master::cli
