-- For Neovim 0.11 or newer: put this file into ~/.config/nvim/plugin/.

vim.filetype.add({ extension = { ron = "ron", comp = "glsl", vert = "glsl", frag = "glsl" } })
vim.lsp.config("splatgraph", {
  cmd = { "splatgraph", "lsp" },
  filetypes = { "ron", "glsl" },
  root_markers = { "pipelines", ".git" },
})
vim.lsp.enable("splatgraph")

-- Barriers before passes, and the values of `let`s.
vim.api.nvim_create_autocmd("LspAttach", {
  callback = function(event)
    local client = vim.lsp.get_client_by_id(event.data.client_id)
    if client and client.name == "splatgraph" then
      vim.lsp.inlay_hint.enable(true, { bufnr = event.buf })
    end
  end,
})
