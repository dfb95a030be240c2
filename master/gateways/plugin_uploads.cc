#include <algorithm>
#include <functional>
#include <future>
#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/master/gateways/plugin_uploads.h>
#include <iotcloud/master/master.h>

namespace iotcloud::master {

using config::Clock;

namespace {

/// One gateway that receives a plugin, or pool that receives a library.
struct Receiver {
  UploadTarget target;
  SiteAddress site;
  bool is_pool = false;
  std::string upload;  ///< the upload's id at the gateway; empty: the gateway gets no (more) pieces
};

struct Upload {
  /// Held while the gateways are called, so that a client that sends another piece of this plugin waits.
  config::Mutex mutex;
  std::vector<Receiver> receivers IOTCLOUD_GUARDED_BY(mutex);
};

struct KnownUpload {
  std::shared_ptr<Upload> upload;
  Clock::Instant last;  ///< when the last call for this upload came
};

/// Calls the action for all receivers that still get the plugin, at the same time. A receiver whose action fails gets
/// no more pieces.
void with_each(std::vector<Receiver>& receivers, const std::function<void(Receiver&)>& action) {
  std::vector<std::pair<Receiver*, std::future<void>>> calls;
  for (auto& receiver : receivers) {
    if (receiver.upload.empty()) continue;
    calls.emplace_back(&receiver, std::async(std::launch::async, [&action, &receiver] { action(receiver); }));
  }
  for (auto& [receiver, call] : calls) {
    try {
      call.get();
    } catch (const std::exception& e) {
      receiver->target.problem = e.what();
      receiver->upload.clear();
    }
  }
}

discovery::PoolId pool_of(const Receiver& receiver) {
  return discovery::PoolId(receiver.target.gateway.str());
}

UploadResult refused(OrderRefusal refusal, std::string text) {
  UploadResult result;
  result.refusal.refusal = refusal;
  result.refusal.text = std::move(text);
  return result;
}

UploadResult answer(const std::string& id, const std::vector<Receiver>& receivers) {
  UploadResult result;
  for (const auto& receiver : receivers) {
    result.targets.push_back(receiver.target);
    if (!receiver.upload.empty()) result.upload = id;
  }
  return result;
}

}  // namespace

std::string UploadResult::summary() const {
  if (refusal.refusal != OrderRefusal::none) return refusal.summary();
  std::vector<std::string> words;
  for (const auto& target : targets)
    words.push_back(fmt::format("{}{}", target.gateway,
                                !target.problem.empty() ? ": " + target.problem
                                : target.has            ? " has it"
                                                        : " takes it"));
  return fmt::format("{}", fmt::join(words, "; "));
}

struct PluginUploads::Impl {
  Impl(const Master& of, GatewayAccess shown, PoolAccess shown_to_pools, const Options& given)
      : master(of),
        access(std::move(shown)),
        pool_access(std::move(shown_to_pools)),
        options(given),
        clock(given.clock != nullptr ? *given.clock : config::system_clock()) {}

  std::shared_ptr<Upload> find(const std::string& id);
  UploadResult pass_on(const std::string& id, const std::function<void(Receiver&)>& action);
  std::optional<UploadResult> receivers_of(const std::vector<discovery::GatewayId>& gateways,
                                           std::vector<Receiver>& receivers);

  const Master& master;
  UploadResult offer(const PluginOffer& offer,
                     const std::function<std::optional<UploadResult>(std::vector<Receiver>&)>& find_receivers);
  std::optional<UploadResult> pools(std::vector<Receiver>& receivers);

  const GatewayAccess access;
  const PoolAccess pool_access;
  const Options options;
  const Clock& clock;
  config::Mutex mutex;
  std::map<std::string, KnownUpload> uploads IOTCLOUD_GUARDED_BY(mutex);
};

PluginUploads::PluginUploads(const Master& master, GatewayAccess access, PoolAccess pools, const Options& options)
    : impl_(std::make_unique<Impl>(master, std::move(access), std::move(pools), options)) {}

PluginUploads::~PluginUploads() = default;

/// Fills `receivers`, with a problem for each gateway that cannot be reached. \return a refusal; nullopt: none.
std::optional<UploadResult> PluginUploads::Impl::receivers_of(const std::vector<discovery::GatewayId>& gateways,
                                                              std::vector<Receiver>& receivers) {
  const auto known = master.gateways();
  std::vector<discovery::GatewayId> names;
  names.reserve(known.size());
  for (const auto& gateway : known) names.push_back(gateway.record.id);
  for (const auto& id : gateways.empty() ? names : gateways) {
    const auto at = std::find_if(known.begin(), known.end(), [&](const auto& g) { return g.record.id == id; });
    if (at == known.end())
      return refused(OrderRefusal::unknown_gateway,
                     fmt::format("no gateway \"{}\"; known gateways: {}", id, fmt::join(names, ", ")));
    Receiver receiver;
    receiver.target.gateway = id;
    try {
      receiver.site = address_of(*at, access);
      receiver.upload = "wanted";
    } catch (const config::Error& e) {
      receiver.target.problem = fmt::format("the plugin cannot be sent to it: {}", e.what());
    }
    receivers.push_back(std::move(receiver));
  }
  if (receivers.empty()) return refused(OrderRefusal::unknown_gateway, "no gateway is registered");
  return std::nullopt;
}

/// Fills `receivers` with all pools, as receivers_of() does.
std::optional<UploadResult> PluginUploads::Impl::pools(std::vector<Receiver>& receivers) {
  for (const auto& pool : master.pools()) {
    Receiver receiver;
    receiver.target.gateway = discovery::GatewayId(pool.id.str());
    receiver.is_pool = true;
    try {
      receiver.site = address_of(pool, pool_access);
      receiver.upload = "wanted";
    } catch (const config::Error& e) {
      receiver.target.problem = fmt::format("the library cannot be sent to it: {}", e.what());
    }
    receivers.push_back(std::move(receiver));
  }
  if (receivers.empty())
    return refused(OrderRefusal::bad_request,
                   "no pool of workers runs; start one on a machine: iotcloud-topology --pool --config pool.yaml");
  return std::nullopt;
}

UploadResult PluginUploads::offer(const PluginOffer& offer, const std::vector<discovery::GatewayId>& gateways) {
  return impl_->offer(offer, [&](auto& receivers) { return impl_->receivers_of(gateways, receivers); });
}

UploadResult PluginUploads::offer_library(const PluginOffer& offer) {
  return impl_->offer(offer, [&](auto& receivers) { return impl_->pools(receivers); });
}

UploadResult PluginUploads::Impl::offer(
    const PluginOffer& offer,
    const std::function<std::optional<UploadResult>(std::vector<Receiver>&)>& find_receivers) try {
  if (auto refusal = master.refusal()) return {*refusal, "", {}};
  {
    const config::MutexLock lock(mutex);
    std::erase_if(uploads, [&](const auto& one) { return clock.now() - one.second.last >= options.idle_limit; });
    if (static_cast<int>(uploads.size()) >= options.most)
      return refused(OrderRefusal::bad_request,
                     fmt::format("this master passes {} plugins on at a time; try again in a moment", options.most));
  }
  std::vector<Receiver> receivers;
  if (auto refusal = find_receivers(receivers)) return *refusal;
  with_each(receivers, [&](Receiver& receiver) {
    receiver.upload = receiver.is_pool
                          ? pool_offer_library(receiver.site, pool_of(receiver), offer, options.answer_limit)
                          : site_offer_plugin(receiver.site, receiver.target.gateway, offer, options.answer_limit);
    receiver.target.has = receiver.upload.empty();
  });
  const std::string id = options.new_upload_id ? options.new_upload_id() : discovery::new_instance_id().str();
  auto result = answer(id, receivers);
  if (result.upload.empty()) return result;
  auto upload = std::make_shared<Upload>();
  {
    const config::MutexLock lock(upload->mutex);
    upload->receivers = std::move(receivers);
  }
  const config::MutexLock lock(mutex);
  uploads[id] = {std::move(upload), clock.now()};
  return result;
} catch (const config::Error& e) {
  return refused(OrderRefusal::registry_away, fmt::format("the registry did not answer: {}", e.what()));
}

std::shared_ptr<Upload> PluginUploads::Impl::find(const std::string& id) {
  const config::MutexLock lock(mutex);
  const auto found = uploads.find(id);
  if (found == uploads.end()) return nullptr;
  found->second.last = clock.now();
  return found->second.upload;
}

UploadResult PluginUploads::Impl::pass_on(const std::string& id, const std::function<void(Receiver&)>& action) {
  const auto upload = find(id);
  if (!upload)
    return refused(OrderRefusal::bad_request,
                   "there is no such upload (any more); one that nobody goes on with ends after a while, and every one "
                   "with its master: send the plugin again");
  UploadResult result;
  {
    const config::MutexLock lock(upload->mutex);
    with_each(upload->receivers, action);
    result = answer(id, upload->receivers);
  }
  if (!result.upload.empty()) return result;
  const config::MutexLock lock(mutex);
  uploads.erase(id);
  return result;
}

UploadResult PluginUploads::send(const std::string& id, std::int64_t offset, const std::string& bytes) {
  return impl_->pass_on(id, [&](Receiver& receiver) {
    const auto limit = impl_->options.answer_limit;
    if (receiver.is_pool) {
      pool_send_library(receiver.site, pool_of(receiver), receiver.upload, offset, bytes, limit);
    } else {
      site_send_plugin(receiver.site, receiver.target.gateway, receiver.upload, offset, bytes, limit);
    }
  });
}

UploadResult PluginUploads::finish(const std::string& id) {
  return impl_->pass_on(id, [&](Receiver& receiver) {
    const auto limit = impl_->options.answer_limit;
    if (receiver.is_pool) {
      pool_finish_library(receiver.site, pool_of(receiver), receiver.upload, limit);
    } else {
      site_finish_plugin(receiver.site, receiver.target.gateway, receiver.upload, limit);
    }
    receiver.target.has = true;
    receiver.upload.clear();
  });
}

}  // namespace iotcloud::master
