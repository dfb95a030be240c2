#include "iotcloud/brokers/server_trust.h"

#include <exception>
#include <new>
#include <utility>

#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/ssl.h>
#include <openssl/x509_vfy.h>

#include <iotcloud/brokers/logger.h>
#include <iotcloud/config/error.h>

namespace iotcloud::brokers {
namespace {

/// Adds all lists in this file. \throws config::Error that names it
void add_lists(X509_STORE* store, const std::string& file) {
  const std::unique_ptr<BIO, decltype(&BIO_free_all)> in(BIO_new_file(file.c_str(), "r"), BIO_free_all);
  int lists = 0;
  bool good = in != nullptr;
  ERR_clear_error();
  while (good) {
    const std::unique_ptr<X509_CRL, decltype(&X509_CRL_free)> list(
        PEM_read_bio_X509_CRL(in.get(), nullptr, nullptr, nullptr), X509_CRL_free);
    if (!list) break;
    good = X509_STORE_add_crl(store, list.get()) == 1;
    ++lists;
  }
  // The end of the file is an error, too, for OpenSSL.
  const bool whole = good && lists > 0 && ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  ERR_clear_error();
  if (whole) return;
  throw config::Error("the list of revoked certificates \"" + file +
                      "\" cannot be used: it must hold lists in PEM form, as revoked.pem of `iotcloud certs`");
}

/// The first objection to a server's certificate, whatever the time: X509_V_OK if there is none.
int objection(X509_STORE* store, X509* own, STACK_OF(X509) * between, unsigned long flags) {
  const std::unique_ptr<X509_STORE_CTX, decltype(&X509_STORE_CTX_free)> check(X509_STORE_CTX_new(),
                                                                              X509_STORE_CTX_free);
  if (!check || X509_STORE_CTX_init(check.get(), store, own, between) != 1 ||
      X509_STORE_CTX_set_default(check.get(), "ssl_server") != 1) {
    throw std::bad_alloc();
  }
  X509_STORE_CTX_set_flags(check.get(), flags | X509_V_FLAG_NO_CHECK_TIME);
  const bool good = X509_verify_cert(check.get()) == 1;
  ERR_clear_error();
  return good ? X509_V_OK : X509_STORE_CTX_get_error(check.get());
}

}  // namespace

int ShownChain::verify(X509_STORE_CTX* check, void* shown) {
  try {
    Certificates certificates;
    X509* const own = X509_STORE_CTX_get0_cert(check);
    if (own != nullptr && X509_up_ref(own) == 1) certificates.own.reset(own, X509_free);
    certificates.between.reset(X509_chain_up_ref(X509_STORE_CTX_get0_untrusted(check)),
                               [](STACK_OF(X509) * all) { sk_X509_pop_free(all, X509_free); });
    auto& chain = *static_cast<ShownChain*>(shown);
    const config::MutexLock lock(chain.mutex_);
    chain.certificates_ = std::move(certificates);
  } catch (const std::exception&) {  // OpenSSL, which calls this, is C: nothing may be thrown through it
    X509_STORE_CTX_set_error(check, X509_V_ERR_OUT_OF_MEM);
    return 0;
  }
  return X509_verify_cert(check);
}

ShownChain::Certificates ShownChain::certificates() const {
  const config::MutexLock lock(mutex_);
  return certificates_;
}

ServerTrust::ServerTrust(std::string ca_file, std::string revoked_file)
    : ca_file_(std::move(ca_file)), revoked_file_(std::move(revoked_file)), seen_(stamps()), used_(seen_) {}

std::shared_ptr<ShownChain> ServerTrust::guard(ssl_ctx_st* context) {
  if (!revoked_file_.empty()) {
    X509_STORE* const store = SSL_CTX_get_cert_store(context);
    add_lists(store, revoked_file_);
    X509_STORE_set_flags(store, X509_V_FLAG_CRL_CHECK);
  }
  const config::MutexLock lock(mutex_);
  auto shown = std::make_shared<ShownChain>(looks_);
  SSL_CTX_set_cert_verify_callback(context, ShownChain::verify, shown.get());
  return shown;
}

std::string ServerTrust::distrust(ShownChain& shown, Instant now) {
  const config::MutexLock lock(mutex_);
  if (now >= look_at_) {
    look_at_ = now + look_period;
    look();
  }
  // What has been read may be older than what the connection was made with, unless a look at the files since then found
  // that it is what they still hold.
  const bool is_current = version_ != 0 && seen_ == used_ && looks_ != shown.after_look_;
  if (!is_current || shown.checked_by_ == version_) return {};
  const ShownChain::Certificates certificates = shown.certificates();
  if (!certificates.own) return {};
  const auto objection_with = [&](unsigned long flags) IOTCLOUD_REQUIRES(mutex_) {
    return objection(store_.get(), certificates.own.get(), certificates.between.get(), flags);
  };
  if (objection_with(0) != X509_V_OK) {
    const std::string trusted = ca_file_.empty() ? "the system's authorities" : "\"" + ca_file_ + "\"";
    return "the server's certificate is of no authority that is trusted any more: there is none of it in " + trusted +
           " now";
  }
  if (!revoked_file_.empty() && objection_with(X509_V_FLAG_CRL_CHECK) == X509_V_ERR_CERT_REVOKED) {
    return "the server's certificate has been revoked: it is on the list \"" + revoked_file_ + "\" now";
  }
  shown.checked_by_ = version_;
  return {};
}

void ServerTrust::look() {
  ++looks_;
  const Stamps now = stamps();
  const bool settled = std::exchange(seen_, now) == now;
  if (!settled) complained_ = false;
  if (!settled || now == used_) return;
  try {
    store_ = read();
  } catch (const config::Error& error) {
    if (!std::exchange(complained_, true)) {
      logger.warn("{}; open connections go on as before, and it is read again", error.what());
    }
    return;
  }
  used_ = now;
  ++version_;
  const bool both = !ca_file_.empty() && !revoked_file_.empty();
  logger.info("whom to trust was replaced ({}{}{}): open connections obey it", ca_file_, both ? ", " : "",
              revoked_file_);
}

ServerTrust::Stamps ServerTrust::stamps() const {
  return {config::stamp_of(ca_file_), config::stamp_of(revoked_file_)};
}

std::shared_ptr<X509_STORE> ServerTrust::read() const {
  std::shared_ptr<X509_STORE> store(X509_STORE_new(), X509_STORE_free);
  if (!store) throw std::bad_alloc();
  ERR_clear_error();
  const bool trusts = ca_file_.empty() ? X509_STORE_set_default_paths(store.get()) == 1
                                       : X509_STORE_load_file(store.get(), ca_file_.c_str()) == 1;
  ERR_clear_error();
  if (!trusts) {
    throw config::Error("the file of trusted authorities \"" + ca_file_ +
                        "\" cannot be used: it must hold their certificates in PEM form");
  }
  if (!revoked_file_.empty()) add_lists(store.get(), revoked_file_);
  return store;
}

}  // namespace iotcloud::brokers
