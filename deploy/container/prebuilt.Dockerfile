# The image of pnet-nat, from a folder that holds the static program:
#
#   cargo build --profile dist --locked --target x86_64-unknown-linux-musl
#   install -D target/x86_64-unknown-linux-musl/dist/pnet-nat target/image/pnet-nat
#   export PNET_NAT_COMMIT="$(git rev-parse --short=12 HEAD)"
#   docker build --build-arg PNET_NAT_COMMIT --tag pnet-nat \
#       --file deploy/container/prebuilt.Dockerfile target/image
#
# From `ARG` on it is the same as Dockerfile; a test holds the two together.

FROM scratch
COPY pnet-nat /usr/bin/pnet-nat
ARG PNET_NAT_COMMIT
LABEL org.opencontainers.image.title="pnet-nat" \
      org.opencontainers.image.description="The NAT router of P-NET on IP (IEC PAS 62412)" \
      org.opencontainers.image.licenses="MIT OR Apache-2.0" \
      org.opencontainers.image.authors="The pnet-nat developers" \
      org.opencontainers.image.version="0.1.0" \
      org.opencontainers.image.revision="$PNET_NAT_COMMIT"
# By number, so that Kubernetes sees that it is not root. Password files have to be this user's.
USER 65532:65532
# The configuration is /etc/pnet-nat/pnet-nat.toml. Its folder is mounted whole: files that are exchanged in
# it are seen at the next reload. Without a file, environment variables such as PNET_NAT_SUBNET will do.
# Asks where [admin] of the configuration says; PNET_NAT_HEALTHCHECK_URL names another place.
HEALTHCHECK --interval=10s --timeout=5s CMD ["/usr/bin/pnet-nat", "healthcheck"]
ENTRYPOINT ["/usr/bin/pnet-nat"]
CMD ["run"]
