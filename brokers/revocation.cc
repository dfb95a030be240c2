#include "iotcloud/brokers/revocation.h"

#include <memory>

#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/ssl.h>

#include <iotcloud/config/error.h>

namespace iotcloud::brokers {

void refuse_revoked(ssl_ctx_st* context, const std::string& file) {
  const std::unique_ptr<BIO, decltype(&BIO_free_all)> in(BIO_new_file(file.c_str(), "r"), BIO_free_all);
  X509_STORE* const store = SSL_CTX_get_cert_store(context);
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
  if (!whole || X509_STORE_set_flags(store, X509_V_FLAG_CRL_CHECK) != 1) {
    throw config::Error("the list of revoked certificates \"" + file +
                        "\" cannot be used: it must hold lists in PEM form, as revoked.pem of `iotcloud certs`");
  }
}

}  // namespace iotcloud::brokers
