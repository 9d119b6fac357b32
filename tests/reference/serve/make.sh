#!/bin/sh
# The certificates of tests/serve.rs: an authority and a certificate of localhost, both of no worth to anyone. They are
# valid for whoever has a clock: `faketime 2020-01-01 sh make.sh`.
set -eu
openssl ecparam -name prime256v1 -genkey -noout -out ca.key
openssl req -x509 -new -key ca.key -days 36500 -subj "/CN=magline test authority" -out ca.pem
openssl ecparam -name prime256v1 -genkey -noout | openssl pkcs8 -topk8 -nocrypt -out localhost.key
openssl req -new -key localhost.key -subj "/CN=localhost" -out localhost.csr
printf 'basicConstraints=CA:FALSE\nsubjectAltName=DNS:localhost,IP:127.0.0.1\n' > localhost.ext
openssl x509 -req -in localhost.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 36500 \
  -extfile localhost.ext -out localhost.pem
rm -f ca.key ca.srl localhost.csr localhost.ext
